"""Objects of rclpy as elements of XML-RPC."""

from __future__ import annotations

import pytest
from rclpy.duration import Duration
from rclpy.qos import QoSPresetProfiles, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo, TopicEndpointTypeEnum
from rclpy.type_hash import TypeHash

from play_launch.graph_daemon.server.marshal import Tagged, TaggedStruct, dump_response
from play_launch.graph_daemon.server.ros_values import to_wire


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
