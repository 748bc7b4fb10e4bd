from __future__ import annotations

from typing import Any

import pytest
from rcl_interfaces.msg import Log
from rclpy.serialization import deserialize_message

from play_launch.config.node_key import NodeKey
from play_launch.recording.forms import convert, is_failure
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
    LogRecord,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
    Stream,
)

STAMP = 1_700_000_000_123_456_789


def converted(event: RunEvent, message_type: type = Log) -> dict[str, Any]:
    return {
        topic.name: deserialize_message(data, message_type) for topic, data, _ in convert(event)
    }


def line(text: str, stream: Stream = Stream.STDOUT) -> OutputLine:
    return OutputLine(stamp_ns=STAMP, process="/a", pid=7, stream=stream, text=text)


@pytest.mark.parametrize(
    ("text", "level"),
    [
        ("[DEBUG] [1700000000.5] [talker]: x", Log.DEBUG),
        ("[INFO] [1700000000.5] [talker]: x", Log.INFO),
        ("[WARN] [1700000000.5] [talker]: x", Log.WARN),
        ("[ERROR] [1700000000.5] [talker]: x", Log.ERROR),
        ("[FATAL] [1700000000.5] [talker]: x", Log.FATAL),
        ("\x1b[33m[WARN] [1700000000.5] [talker]: x\x1b[0m", Log.WARN),
        ("\x1b[0m\x1b[1m[ INFO] [talker]: x", Log.INFO),
        ("[WARNING] x", Log.WARN),
    ],
)
def test_the_severity_of_a_line_decides_on_either_stream(text: str, level: int) -> None:
    for stream in Stream:
        assert converted(line(text, stream))["/play_launch/output"].level == level


@pytest.mark.parametrize(
    "text", ["hello", "", "[1, 2, 3]", "[SOMETHING] x", "x [ERROR] y", "[INFO"]
)
def test_a_line_without_severity_counts_by_its_stream(text: str) -> None:
    assert converted(line(text))["/play_launch/output"].level == 20
    assert converted(line(text, Stream.STDERR))["/play_launch/output"].level == 30


def test_output_keeps_process_stream_and_pid() -> None:
    message = converted(line("grüße", Stream.STDERR))["/play_launch/output"]
    assert (message.name, message.msg, message.file, message.function) == (
        "/a",
        "grüße",
        "stderr",
        "pid 7",
    )
    assert message.stamp.sec * 10**9 + message.stamp.nanosec == STAMP


def test_a_cut_line_says_so() -> None:
    event = OutputLine(
        stamp_ns=STAMP, process="/a", pid=7, stream=Stream.STDOUT, text="long", truncated=True
    )
    assert converted(event)["/play_launch/output"].msg == "long [cut]"


@pytest.mark.parametrize("level", [10, 20, 30, 40, 50])
def test_warnings_stand_in_both_logs(level: int) -> None:
    event = LogRecord(
        stamp_ns=STAMP, level=level, name="n", message="m", file="f.py", function="g", line=3
    )
    found = converted(event)
    assert set(found) == (
        {"/play_launch/log/all"} if level < 30 else {"/play_launch/log/all", "/play_launch/log"}
    )
    message = found["/play_launch/log/all"]
    assert (message.level, message.name, message.msg) == (level, "n", "m")
    assert (message.file, message.function, message.line) == ("f.py", "g", 3)


def component(kind: ComponentEventKind) -> ComponentEvent:
    return ComponentEvent(
        stamp_ns=STAMP,
        kind=kind,
        container="/c",
        unique_id=1,
        attempt=1,
        full_node_name="/n",
        package_name="p",
        plugin_name="p::N",
    )


def test_failures_are_told_from_the_rest() -> None:
    failed = {kind for kind in ComponentEventKind if is_failure(component(kind))}
    assert failed == {ComponentEventKind.LOAD_FAILED, ComponentEventKind.CRASHED}
    exited = ProcessEvent(stamp_ns=STAMP, kind=ProcessEventKind.EXITED, name="/c")
    assert not is_failure(exited)
    killed = ProcessEvent(stamp_ns=STAMP, kind=ProcessEventKind.EXITED, name="/c", signal=9)
    assert is_failure(killed)
    given_up = NodeStateChanged(stamp_ns=STAMP, key=NodeKey("/c", "/n"), state=NodeState.GAVE_UP)
    assert is_failure(given_up)
    assert is_failure(LogRecord(stamp_ns=STAMP, level=40, name="n", message="m"))
    assert not is_failure(line("[ERROR] lines are looked at when they are written"))
