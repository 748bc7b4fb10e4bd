from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from rcl_interfaces.msg import Log
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore

from play_launch.container.cdr.layout import text_bytes
from play_launch.container.cdr.messages import log_message

STORE = get_typestore(Stores.ROS2_JAZZY)
WORDS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=40)


@given(
    stamp_ns=st.integers(0, (2**31 - 1) * 1_000_000_000),
    level=st.sampled_from([10, 20, 30, 40, 50]),
    name=WORDS,
    message=WORDS,
    file=WORDS,
    function=WORDS,
    line=st.integers(0, 2**32 - 1),
)
def test_the_bytes_are_those_of_other_serialisers(
    stamp_ns: int, level: int, name: str, message: str, file: str, function: str, line: int
) -> None:
    expected = Log(level=level, name=name, msg=message, file=file, function=function, line=line)
    expected.stamp.sec, expected.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    data = log_message(stamp_ns, level, name, message, file=file, function=function, line=line)
    assert deserialize_message(data, Log) == expected
    # Fast CDR leaves in its padding what the memory held before, so only the size is compared.
    assert len(data) == len(serialize_message(expected))
    types = STORE.types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
    other = types["rcl_interfaces/msg/Log"](stamp, level, name, message, file, function, line)
    assert data == bytes(STORE.serialize_cdr(other, "rcl_interfaces/msg/Log"))


@given(st.text(st.characters()))
def test_any_text_can_be_recorded(text: str) -> None:
    read = deserialize_message(log_message(0, 20, "n", text), Log)
    assert read.msg == text_bytes(text).decode()


def test_what_a_cdr_string_cannot_hold_is_written_as_an_escape() -> None:
    assert text_bytes("a\0b\udc80ä") == r"a\x00b\udc80ä".encode()


def test_stamps_out_of_range_become_the_nearest_possible() -> None:
    early = deserialize_message(log_message(-5, 20, "", ""), Log)
    late = deserialize_message(log_message(2**63, 20, "", ""), Log)
    assert (early.stamp.sec, early.stamp.nanosec) == (0, 0)
    assert (late.stamp.sec, late.stamp.nanosec) == (2**31 - 1, 999_999_999)
