"""Traces keep to the format, whatever happened, and show it."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from play_launch.cli.export import export as export_session
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    LogRecord,
    MemoryKind,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    ProcessSample,
    RunEvent,
    Stream,
    SubjectKind,
)
from tests.postmortem.export.trace_format import read_trace
from tests.postmortem.test_past_session import EVERYTHING, record

KEY = NodeKey("/box", "/talker")


def traced(events: list[RunEvent]) -> list[dict[str, Any]]:
    with tempfile.TemporaryDirectory() as folder:
        path = record(Path(folder) / "x.mcap", events)
        output = Path(folder) / "trace.json"
        assert export_session(path, "perfetto", output) == 0
        return read_trace(output)


def node(state: NodeState, **more: Any) -> NodeStateChanged:
    return NodeStateChanged(stamp_ns=5, key=KEY, state=state, **more)


def process(kind: ProcessEventKind, **more: Any) -> ProcessEvent:
    return ProcessEvent(stamp_ns=5, kind=kind, name="/tool", **more)


def sample(**more: Any) -> ProcessSample:
    values: dict[str, Any] = dict.fromkeys(ProcessSample.__struct_fields__, 0)
    values |= {"kind": SubjectKind.NODE, "key": str(KEY), "memory_kind": MemoryKind.PSS}
    return ProcessSample(**{**values, **more})


@settings(max_examples=60)
@given(st.lists(EVERYTHING, max_size=20))
def test_any_session_becomes_a_trace_that_keeps_to_the_format(events: list[RunEvent]) -> None:
    traced(events)


def test_states_are_slices_and_a_crash_is_a_mark_with_its_backtrace() -> None:
    crash = ComponentEvent(
        stamp_ns=5,
        kind=ComponentEventKind.CRASHED,
        container="",
        unique_id=1,
        attempt=1,
        full_node_name="/talker",
        package_name="p",
        plugin_name="c",
        backtrace=("main() at a.cpp:5", "start"),
    )
    events = traced(
        [
            ContainerStateChanged(stamp_ns=5, container="/box", state=ContainerState.RUNNING),
            node(NodeState.LOADING),
            node(NodeState.LOADING, reason="slow"),
            node(NodeState.LOADED, pid=7),
            crash,
            node(NodeState.CRASHED, reason="SIGSEGV"),
            node(NodeState.LOADED, pid=8),
        ]
    )
    names = {event["pid"]: event["args"]["name"] for event in events if event["ph"] == "M"
             and event["name"] == "process_name"}  # fmt: skip
    threads = {event["tid"]: event["args"]["name"] for event in events if event["ph"] == "M"
               and event["name"] == "thread_name"}  # fmt: skip
    assert list(names.values()) == ["/box"]
    slices = [(threads[event["tid"]], event["name"]) for event in events if event["ph"] == "X"]
    assert sorted(slices) == [
        ("/talker", "crashed"),
        ("/talker", "loaded"),
        ("/talker", "loaded"),
        ("/talker", "loading"),
        ("container", "running"),
    ]
    (mark,) = [event for event in events if event["ph"] == "i"]
    assert (mark["name"], threads[mark["tid"]]) == ("crashed", "/talker")
    assert mark["args"]["reason"] == "SIGSEGV"
    assert mark["args"]["backtrace"] == "main() at a.cpp:5\nstart"


def test_the_end_of_a_process_errors_and_warnings_are_marks() -> None:
    events = traced(
        [
            process(ProcessEventKind.STARTED, pid=3),
            OutputLine(
                stamp_ns=5, process="/tool", pid=3, stream=Stream.STDERR, text="[ERROR] [x]: no"
            ),
            OutputLine(stamp_ns=5, process="/tool", pid=3, stream=Stream.STDOUT, text="fine"),
            LogRecord(stamp_ns=5, level=30, name="l", message="careful"),
            LogRecord(stamp_ns=5, level=20, name="l", message="by the way"),
            process(ProcessEventKind.EXITED, signal=9, message="exited with signal 9"),
        ]
    )
    marks = [event for event in events if event["ph"] == "i"]
    assert [mark["name"] for mark in marks] == ["[ERROR] [x]: no", "careful", "died"]
    assert "signal 9" in marks[-1]["args"]["reason"]


def test_samples_are_curves_that_hold_their_value() -> None:
    events = traced(
        [
            sample(cpu_percent=12.34, memory_bytes=5_000_000, threads=3, descriptors=9),
            sample(cpu_percent=12.34, memory_bytes=5_000_000, threads=3, descriptors=9),
            sample(cpu_percent=50.0, memory_bytes=7_000_000, memory_kind=MemoryKind.SHARED),
        ]
    )
    curves = [(event["name"], event["args"]) for event in events if event["ph"] == "C"]
    assert curves == [
        ("cpu /talker", {"percent": 12.3}),
        ("memory /talker", {"MB": 5.0}),
        ("descriptors /talker", {"count": 9}),
        ("threads /talker", {"count": 3}),
        ("cpu /talker", {"percent": 50.0}),
        ("threads /talker", {"count": 0}),
    ]
