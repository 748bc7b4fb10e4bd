"""The layouts are those of the interface definitions, and the bytes those of other serialisers."""

from __future__ import annotations

import math
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy
from rcl_interfaces.msg import Log
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from play_launch.container.cdr import messages
from play_launch.container.cdr.messages import LOG, PROCESS_STATS, log_message
from play_launch.container.cdr.structure import CdrError, Layout, text_bytes

DEFINITIONS = Path(__file__).resolve().parents[3] / "interfaces" / "play_launch_msgs"
LAYOUTS = {
    "".join(word.title() for word in name.split("_")): layout
    for name, layout in vars(messages).items()
    if isinstance(layout, Layout)
}
OF_ROS = {"Parameter", "ParameterEvent", "ParameterValue", "Log"}
OURS = {name: layout for name, layout in LAYOUTS.items() if name not in OF_ROS}
STORE = get_typestore(Stores.ROS2_JAZZY)
for path in sorted((DEFINITIONS / "msg").glob("*.msg")):
    STORE.register(get_types_from_msg(path.read_text(), f"play_launch_msgs/msg/{path.stem}"))

RANGES = {
    code: st.integers(low, high)
    for code, low, high in (
        ("B", 0, 2**8 - 1),
        ("H", 0, 2**16 - 1),
        ("I", 0, 2**32 - 1),
        ("Q", 0, 2**64 - 1),
        ("i", -(2**31), 2**31 - 1),
        ("q", -(2**63), 2**63 - 1),
    )
}
TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)


def values(layout: Layout) -> SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({name: value(kind) for name, kind in layout.types.items()})


def value(kind: str) -> SearchStrategy[Any]:
    if kind.endswith("[]"):
        return st.lists(value(kind.removesuffix("[]")), max_size=3).map(tuple)
    match kind:
        case "s":
            return TEXT
        case "y":
            return st.binary(max_size=5)
        case "?":
            return st.booleans()
        case "d":
            return st.floats(allow_nan=False)
        case "t":
            return st.integers(0, (2**31 - 1) * 1_000_000_000)
    return values(LAYOUTS[kind]) if kind in LAYOUTS else RANGES[kind]


def message_type(name: str) -> Any:
    package = "rcl_interfaces" if name in OF_ROS else "play_launch_msgs"
    return getattr(import_module(f"{package}.msg"), name)


def as_ros(name: str, given: dict[str, Any]) -> Any:
    message = message_type(name)()
    for field, kind in LAYOUTS[name].types.items():
        each = given[field]
        if kind == "t":
            message.stamp.sec, message.stamp.nanosec = divmod(each, 1_000_000_000)
            continue
        if kind == "y":
            each = [bytes((octet,)) for octet in each]
        elif kind in LAYOUTS:
            each = as_ros(kind, each)
        elif kind.removesuffix("[]") in LAYOUTS:
            each = [as_ros(kind.removesuffix("[]"), one) for one in each]
        setattr(message, field, list(each) if isinstance(each, tuple) else each)
    return message


def test_every_definition_has_a_layout() -> None:
    assert OURS.keys() == {path.stem for path in (DEFINITIONS / "msg").glob("*.msg")}


@pytest.mark.parametrize("name", LAYOUTS)
@settings(max_examples=25)
@given(data=st.data())
def test_rclpy_reads_what_is_written_and_is_read(name: str, data: st.DataObject) -> None:
    given = data.draw(values(LAYOUTS[name]))
    written = LAYOUTS[name].write(given)
    expected = as_ros(name, given)
    assert deserialize_message(written, message_type(name)) == expected
    theirs = bytes(serialize_message(expected))
    # Not equal: Fast CDR leaves in its padding what the memory held before, also at the end.
    assert len(written) <= len(theirs)
    assert LAYOUTS[name].read(theirs) == LAYOUTS[name].read(written) == given


@pytest.mark.parametrize("name", OURS)
@settings(max_examples=10)
@given(data=st.data())
def test_the_bytes_are_those_of_another_serialiser(name: str, data: st.DataObject) -> None:
    written = LAYOUTS[name].write(data.draw(values(LAYOUTS[name])))
    full = f"play_launch_msgs/msg/{name}"
    read = STORE.deserialize_cdr(written, full)
    # It aligns also what is empty, so that bytes differ where a sequence of numbers is.
    if not any("[]" in kind and kind != "s[]" for kind in LAYOUTS[name].types.values()):
        assert bytes(STORE.serialize_cdr(read, full)) == written


@pytest.mark.parametrize("name", LAYOUTS)
def test_what_is_not_given_is_zero_or_empty(name: str) -> None:
    nothing = LAYOUTS[name].write({})
    assert deserialize_message(nothing, message_type(name)) == message_type(name)()


@given(st.sampled_from([*LAYOUTS]), st.data())
def test_damaged_bytes_are_a_message_or_an_error_of_ours(name: str, data: st.DataObject) -> None:
    layout = LAYOUTS[name]
    written = bytearray(layout.write(data.draw(values(layout))))
    for _ in range(data.draw(st.integers(0, 3))):
        written[data.draw(st.integers(0, len(written) - 1))] = data.draw(st.integers(0, 255))
    kept = bytes(written[: data.draw(st.integers(0, len(written)))])
    try:
        assert layout.read(kept).keys() == layout.types.keys()
    except CdrError:
        assert kept != layout.write({})


def test_a_number_of_elements_is_not_believed() -> None:
    with pytest.raises(CdrError, match="4294967295 elements"):
        messages.CONTROL_QUERY.read(b"\0\1\0\0" + bytes(8) + b"\xff" * 4 + bytes(100))


def test_text_that_is_not_utf8_is_read_all_the_same() -> None:
    data = messages.CONTROL_SHUTDOWN.write({"reason": "aXb"}).replace(b"X", b"\xff")
    assert messages.CONTROL_SHUTDOWN.read(data) == {"reason": "a\ufffdb"}


def test_a_field_that_does_not_exist_is_an_error() -> None:
    with pytest.raises(KeyError, match="raeson"):
        messages.CONTROL_SHUTDOWN.write({"raeson": ""})
    with pytest.raises(KeyError, match="unique"):
        messages.CONTROL_CANCEL.write({"unique": 1})  # of numbers alone


def test_a_double_that_is_no_number_stays_one() -> None:
    layout = messages.PARAMETER_VALUE
    read = layout.read(layout.write({"double_array_value": (math.nan, -0.0)}))
    assert math.isnan(read["double_array_value"][0])
    assert math.copysign(1, read["double_array_value"][1]) == -1


@given(st.data())
def test_picked_numbers_are_those_that_are_read(data: st.DataObject) -> None:
    written = PROCESS_STATS.write(data.draw(values(PROCESS_STATS)))
    names = [name for name in PROCESS_STATS.types if name != "stamp"]
    chosen = data.draw(st.lists(st.sampled_from(names), unique=True))
    in_order = [name for name in names if name in chosen]
    read = PROCESS_STATS.read(written)
    found = PROCESS_STATS.picker(*chosen)(written)
    assert repr(found) == repr(tuple(read[name] for name in in_order))
    for damaged in (written[:-1], b"\0\0" + written[2:], b""):
        with pytest.raises(CdrError):
            PROCESS_STATS.picker(*chosen)(damaged)


def test_only_numbers_of_messages_of_numbers_are_picked() -> None:
    for layout, name in ((PROCESS_STATS, "stamp"), (PROCESS_STATS, "nothing"), (LOG, "level")):
        with pytest.raises(ValueError, match=name):
            layout.picker(name)


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


def test_what_a_cdr_string_cannot_hold_is_written_as_an_escape() -> None:
    assert text_bytes("a\0b\udc80ä") == r"a\x00b\udc80ä".encode()


def test_stamps_out_of_range_become_the_nearest_possible() -> None:
    early = deserialize_message(log_message(-5, 20, "", ""), Log)
    late = deserialize_message(log_message(2**63, 20, "", ""), Log)
    assert (early.stamp.sec, early.stamp.nanosec) == (0, 0)
    assert (late.stamp.sec, late.stamp.nanosec) == (2**31 - 1, 999_999_999)
