"""XML-RPC as ros2cli's daemon and its clients read and write it; rclpy's objects in it."""

from __future__ import annotations

import re
import xmlrpc.client
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.duration import Duration
from rclpy.qos import QoSPresetProfiles, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo, TopicEndpointTypeEnum
from rclpy.type_hash import TypeHash

from play_launch.graph_daemon.server.marshal import (
    DocumentTypeError,
    Tagged,
    TaggedStruct,
    dump_fault,
    dump_response,
    parse_call,
    to_wire,
)
from play_launch.graph_daemon.server.methods import Call, parse
from tests.graph_daemon.wire import read

scalars = (
    st.none()
    | st.booleans()
    | st.integers(-(2**31), 2**31 - 1)
    | st.floats(allow_nan=False)
    | st.text()
    | st.binary(max_size=200)
)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner) | st.lists(inner).map(tuple) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


def reference(value: Any) -> bytes:
    text = xmlrpc.client.dumps((value,), methodresponse=True, allow_none=True)
    return encoded(text)


def encoded(text: str) -> bytes:
    """As Python writes it, but for characters that would make it no XML."""
    kept = re.sub("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]", "\ufffd", text)
    return kept.encode("utf-8", "xmlcharrefreplace")


@given(values)
def test_plain_values_are_written_as_python_does(value: Any) -> None:
    assert dump_response(value) == reference(value)


@pytest.mark.parametrize("character", ["\x00", "\x1b", "\x1f", "\ud800", "\ufffe"])
def test_a_character_that_xml_does_not_have_spoils_no_answer(character: str) -> None:
    names = [[f"a{character}b", "/"], ["talker", "/"]]
    found, _ = xmlrpc.client.loads(dump_response(names))
    assert found == ([["a\ufffdb", "/"], ["talker", "/"]],)
    with pytest.raises(xmlrpc.client.Fault, match="ValueError"):
        xmlrpc.client.loads(dump_fault(ValueError(f"a{character}b")))


@given(st.text())
def test_faults_are_written_as_python_does(text: str) -> None:
    fault = xmlrpc.client.Fault(1, f"<class 'ValueError'>:{text}")
    written = encoded(xmlrpc.client.dumps(fault, allow_none=True))
    assert dump_fault(ValueError(text)) == written
    assert dump_fault(fault) == written


@pytest.mark.parametrize("value", [2**31, -(2**31) - 1, 2**63])
def test_an_integer_beyond_32_bits_is_an_error(value: int) -> None:
    with pytest.raises(OverflowError):
        dump_response([value])


@pytest.mark.parametrize("value", [object(), {1: 2}, {1, 2}, range(3)])
def test_what_xml_rpc_does_not_know_is_an_error(value: object) -> None:
    with pytest.raises(TypeError):
        dump_response(value)


def test_elements_of_ros_are_written() -> None:
    value = TaggedStruct(
        "rclpy.qos.QoSProfile", {"lifespan": Tagged("rclpy.duration.Duration", "5")}
    )
    assert read(dump_response([value])) == [
        ["rclpy.qos.QoSProfile", {"lifespan": ["rclpy.duration.Duration", "5"]}]
    ]


@given(st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Cs"))), st.lists(scalars))
def test_calls_are_read_as_python_does(method: str, arguments: list[Any]) -> None:
    body = xmlrpc.client.dumps(tuple(arguments), method, allow_none=True).encode()
    try:
        expected = xmlrpc.client.loads(body)
    except Exception as error:  # noqa: BLE001 - whatever it is, it must be the same
        with pytest.raises(type(error)):
            parse_call(body)
        return
    found, name = parse_call(body)[1], parse_call(body)[0]
    assert (found, name) == expected


@given(st.binary() | st.text().map(str.encode) | values.map(dump_response))
def test_whatever_comes_is_a_call_or_answered_by_a_fault(body: bytes) -> None:
    found = parse(body)
    if isinstance(found, bytes):
        assert read(found)[0] == "fault"
    else:
        assert isinstance(found, Call)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_a_document_type_is_refused(encoding: str) -> None:
    entities = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 12))
    text = (
        f'<?xml version="1.0"?><!DOCTYPE d [<!ENTITY e0 "x">{entities}]>'
        "<methodCall><methodName>get_name</methodName>"
        "<params><param><value>&e11;</value></param></params></methodCall>"
    )
    with pytest.raises(DocumentTypeError):
        parse_call(text.encode(encoding))


def test_deep_nesting_ends_in_an_answer() -> None:
    depth = 1_000
    inside = "<value><array><data>" * depth + "</data></array></value>" * depth
    params = f"<params><param>{inside}</param></params>"
    found = parse(f"<methodCall><methodName>m</methodName>{params}</methodCall>".encode())
    assert isinstance(found, Call)
    assert found.method == "m"


def members(value: object) -> dict[str, object]:
    assert isinstance(value, TaggedStruct)
    return dict(value.members)


def test_a_duration_is_its_nanoseconds() -> None:
    forever = Duration(nanoseconds=2**63 - 1)
    assert to_wire(forever) == Tagged("rclpy.duration.Duration", "9223372036854775807")


def test_an_enumeration_is_its_number() -> None:
    policy = to_wire(ReliabilityPolicy.BEST_EFFORT)
    assert policy == Tagged("rclpy.qos.ReliabilityPolicy", "2")


@pytest.mark.parametrize("preset", list(QoSPresetProfiles), ids=str)
def test_a_profile_has_its_members_in_order(preset: QoSPresetProfiles) -> None:
    profile = preset.value
    found = to_wire(profile)
    assert list(members(found)) == [slot.lstrip("_") for slot in QoSProfile.__slots__]
    assert members(found)["depth"] == profile.depth


def test_an_endpoint_is_written_whole() -> None:
    endpoint = TopicEndpointInfo(
        node_name="talker",
        node_namespace="/",
        topic_type="std_msgs/msg/String",
        topic_type_hash=TypeHash(1, bytes(range(32))),
        endpoint_type=TopicEndpointTypeEnum.PUBLISHER,
        endpoint_gid=list(range(16)),
        qos_profile=QoSProfile(depth=7),
    )
    found = to_wire(endpoint)
    values = members(found)
    assert values["endpoint_gid"] == list(range(16))
    assert members(values["topic_type_hash"]) == {"version": 1, "value": bytes(range(32))}
    assert dump_response([found]).count(b"<rclpy.") == 11


@pytest.mark.parametrize("value", [1, "text", b"bytes", True, None, object])
def test_everything_else_stays(value: object) -> None:
    assert to_wire(value) is value
