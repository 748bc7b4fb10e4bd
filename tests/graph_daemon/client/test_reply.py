"""Reading XML-RPC: the same values as the standard library, and no others."""

from __future__ import annotations

from typing import Any
from xmlrpc.client import Fault as TheirFault
from xmlrpc.client import dumps

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.graph_daemon.client.reply import Fault, ReplyFormatError, read_reply

# What XML 1.0 can hold.
TEXT = st.text(
    st.characters(
        exclude_categories=["Cs"],
        exclude_characters=[*map(chr, range(32)), "\ufffe", "\uffff"],
    )
)
VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**31), 2**31 - 1)
    | st.floats(allow_nan=False, allow_infinity=False)
    | TEXT,
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(TEXT, inner, max_size=5),
    max_leaves=20,
)


def written(value: Any) -> bytes:
    return dumps((value,), methodresponse=True, allow_none=True).encode()


@given(VALUES)
def test_what_the_standard_library_writes_is_read(value: Any) -> None:
    assert read_reply(written(value)) == value


def test_a_value_without_a_type_is_a_string() -> None:
    body = b"<methodResponse><params><param><value>a b</value></param></params></methodResponse>"
    assert read_reply(body) == "a b"
    assert read_reply(body.replace(b"a b", b"")) == ""


def test_a_fault_is_raised() -> None:
    body = dumps(TheirFault(7, "<class 'E'>:it & that"), methodresponse=True).encode()
    with pytest.raises(Fault) as fault:
        read_reply(body)
    assert (fault.value.code, fault.value.text) == (7, "<class 'E'>:it & that")


@given(st.binary(max_size=300))
def test_noise_is_never_taken_for_a_reply(noise: bytes) -> None:
    with pytest.raises(ReplyFormatError):
        read_reply(noise)


@given(VALUES, st.data())
def test_a_reply_that_is_cut_is_none(value: Any, data: st.DataObject) -> None:
    whole = written(value).rstrip()
    cut = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(ReplyFormatError):
        read_reply(whole[:cut])


@pytest.mark.parametrize(
    "value",
    [
        "<int>x</int>",
        "<boolean>2</boolean>",
        "<double/>",
        "<base64>AA==</base64>",
        "<rclpy.duration.Duration><i8>1</i8></rclpy.duration.Duration>",
        "<struct><member><value><int>1</int></value></member></struct>",
        "<array><data><value>",
    ],
)
def test_malformed_and_foreign_values_are_refused(value: str) -> None:
    body = (
        f"<methodResponse><params><param><value>{value}</value></param></params></methodResponse>"
    )
    with pytest.raises(ReplyFormatError):
        read_reply(body.encode())


def test_nesting_is_bounded() -> None:
    value: Any = "x"
    for _ in range(40):
        value = [value]
    with pytest.raises(ReplyFormatError, match="nested deeper than 32"):
        read_reply(written(value))


def test_a_call_is_no_reply() -> None:
    with pytest.raises(ReplyFormatError):
        read_reply(dumps((1,), "get_name").encode())
