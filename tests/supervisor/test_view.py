from __future__ import annotations

import signal
from typing import Any

import pytest
from msgspec.structs import replace

from play_launch import ExitCode
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import (
    ContainerState,
    ContainerStateChanged,
    ManagedNodeChanged,
    ManagedState,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
    Stream,
    SubjectKind,
    Withdrawn,
)
from play_launch.supervisor.view import (
    SystemView,
    crashed_while_stopped,
    exit_code,
    has_failed,
)


def node(state: NodeState, index: int = 0, stamp_ns: int = 1, **more: Any) -> NodeStateChanged:
    return NodeStateChanged(stamp_ns=stamp_ns, key=NodeKey("/c", f"/n{index}"), state=state, **more)


def process(kind: ProcessEventKind, name: str = "/p", **more: Any) -> ProcessEvent:
    return ProcessEvent(stamp_ns=1, kind=kind, name=name, **more)


def container(state: ContainerState) -> ContainerStateChanged:
    return ContainerStateChanged(stamp_ns=1, container="/c", state=state)


RUNS = container(ContainerState.RUNNING)


def fold(*events: RunEvent) -> SystemView:
    view = SystemView()
    for event in events:
        view = view.after(event)
    return view


def test_counts_declared_and_loaded_nodes() -> None:
    view = fold(
        container(ContainerState.RUNNING),
        node(NodeState.LOADING, 0, 5),
        node(NodeState.PENDING, 1),
        node(NodeState.LOADED, 1),
        node(NodeState.LOAD_FAILED, 2, reason="no such plugin"),
    )
    assert (view.loaded, view.total) == (1, 3)
    assert [each.node for each in view.waiting] == ["/n0"]
    assert [each.reason for each in view.failed] == ["no such plugin"]


def test_a_repeated_report_does_not_move_the_beginning() -> None:
    view = fold(node(NodeState.LOADING, stamp_ns=5), node(NodeState.LOADING, stamp_ns=9))
    assert view.waiting[0].stamp_ns == 5


def test_a_container_s_process_is_no_process_of_its_own() -> None:
    view = fold(
        container(ContainerState.STARTING),
        process(ProcessEventKind.STARTED, "/c", pid=12),
        process(ProcessEventKind.STARTED, "/p", pid=13),
    )
    assert view.containers["/c"].process.pid == 12
    assert list(view.processes) == ["/p"]


def test_output_changes_nothing() -> None:
    view = fold(node(NodeState.LOADED))
    line = OutputLine(stamp_ns=1, process="/c", pid=1, stream=Stream.STDOUT, text="hello")
    assert view.after(line) is view


@pytest.mark.parametrize(
    ("events", "code"),
    [
        ([], ExitCode.OK),
        ([RUNS, node(NodeState.LOADED)], ExitCode.OK),
        ([RUNS], ExitCode.OK),
        ([RUNS, node(NodeState.LOADED), node(NodeState.LOADING, 1)], ExitCode.NODES_MISSING),
        ([RUNS, node(NodeState.LOST)], ExitCode.NODES_MISSING),
        # Unloaded on its own, by its container or by another program.
        ([RUNS, node(NodeState.UNLOADED)], ExitCode.NODES_MISSING),
        ([RUNS, node(NodeState.LOADED), node(NodeState.UNLOADED, 1)], ExitCode.NODES_MISSING),
        ([RUNS, node(NodeState.UNLOADING)], ExitCode.NODES_MISSING),
        # Between two starts, with and without nodes.
        ([container(ContainerState.BACKOFF)], ExitCode.NODES_MISSING),
        ([container(ContainerState.STARTING)], ExitCode.NODES_MISSING),
        ([container(ContainerState.BACKOFF), node(NodeState.UNLOADED)], ExitCode.NODES_MISSING),
        ([node(NodeState.LOST), node(NodeState.LOAD_FAILED, 1)], ExitCode.NODE_FAILED),
        ([node(NodeState.CRASHED)], ExitCode.NODE_FAILED),
        ([container(ContainerState.GAVE_UP)], ExitCode.NODE_FAILED),
        ([process(ProcessEventKind.EXITED)], ExitCode.OK),
        ([process(ProcessEventKind.EXITED, exit_code=3)], ExitCode.NODE_FAILED),
        ([process(ProcessEventKind.EXITED, signal=9)], ExitCode.NODE_FAILED),
        ([process(ProcessEventKind.GAVE_UP)], ExitCode.NODE_FAILED),
        (
            [process(ProcessEventKind.EXITED, signal=9), process(ProcessEventKind.RESTARTING)],
            ExitCode.NODES_MISSING,
        ),
    ],
)
def test_exit_code(events: list[RunEvent], code: ExitCode) -> None:
    view = fold(*events)
    assert exit_code(view, view, None) == code
    assert exit_code(view, view, signal.SIGINT) == 130


@pytest.mark.parametrize(
    ("end", "code"),
    [
        (process(ProcessEventKind.EXITED, signal=11), ExitCode.NODE_FAILED),
        (process(ProcessEventKind.EXITED, signal=9), ExitCode.OK),
        (process(ProcessEventKind.EXITED, signal=15), ExitCode.OK),
        (process(ProcessEventKind.EXITED, exit_code=3), ExitCode.OK),
    ],
)
def test_only_a_crash_makes_a_stop_a_failure(end: ProcessEvent, code: ExitCode) -> None:
    before = SystemView().after(replace(end, kind=ProcessEventKind.STARTED, pid=7))
    assert exit_code(before, before.after(end), None) == code
    # Of a container as well.
    runs = SystemView().after(replace(RUNS, container=end.name))
    before = runs.after(replace(end, kind=ProcessEventKind.STARTED, pid=7))
    after = before.after(end)
    assert exit_code(before, after, None) == code
    # What had ended before was judged before.
    assert exit_code(after, after, None) == ExitCode.OK


def test_a_node_of_its_own_process_can_crash_while_it_is_stopped() -> None:
    before = fold(RUNS, node(NodeState.LOADED))
    after = before.after(node(NodeState.CRASHED, stamp_ns=2, crashes=1))
    assert exit_code(before, after, None) == ExitCode.NODE_FAILED
    assert crashed_while_stopped(before, after) == [str(node(NodeState.CRASHED).key)]
    # Its container is gone then, too.
    lost = after.after(node(NodeState.LOST, stamp_ns=3, crashes=1))
    assert exit_code(before, lost, None) == ExitCode.NODE_FAILED
    assert exit_code(before, before.after(node(NodeState.UNLOADED)), None) == ExitCode.OK
    # One that had crashed before, and was there again, left in order.
    again = before.after(node(NodeState.LOADED, stamp_ns=2, crashes=1))
    left = again.after(node(NodeState.UNLOADED, stamp_ns=3, crashes=1))
    assert exit_code(again, left, None) == ExitCode.OK


def test_a_process_that_is_given_up_while_it_runs_stays_so_when_it_ends() -> None:
    def event(kind: ProcessEventKind, message: str = "") -> ProcessEvent:
        return ProcessEvent(stamp_ns=1, kind=kind, name="/p", message=message)

    view = SystemView()
    for each in (
        event(ProcessEventKind.STARTED),
        event(ProcessEventKind.GAVE_UP, "internal error"),
        event(ProcessEventKind.STOPPING, "the end"),
        event(ProcessEventKind.EXITED),
    ):
        view = view.after(each)
    assert has_failed(view.processes["/p"])
    assert view.processes["/p"].message == "internal error"
    assert not has_failed(view.after(event(ProcessEventKind.STARTED)).processes["/p"])


def test_what_was_taken_out_counts_no_more() -> None:
    view = fold(process(ProcessEventKind.EXITED, signal=9))
    (name,) = view.processes
    assert exit_code(view, view, None) == ExitCode.NODE_FAILED
    view = view.after(Withdrawn(stamp_ns=2, kind=SubjectKind.PROCESS, key=name))
    assert not view.processes
    assert exit_code(view, view, None) == ExitCode.OK
    for key in (NodeKey("/c", "/a"), NodeKey("/c", "/b")):
        view = view.after(NodeStateChanged(stamp_ns=3, key=key, state=NodeState.CRASHED))
    view = view.after(Withdrawn(stamp_ns=4, kind=SubjectKind.NODE, key="/c:/a"))
    assert [key.name for key in view.containers["/c"].nodes] == ["/b"]
    view = view.after(Withdrawn(stamp_ns=5, kind=SubjectKind.NODE, key="/elsewhere:/a"))
    view = view.after(Withdrawn(stamp_ns=6, kind=SubjectKind.CONTAINER, key="/c"))
    assert not view.containers


def test_a_managed_node_counts_whatever_else_was_stopped_by_hand() -> None:
    view = SystemView()
    for event in (
        process(ProcessEventKind.READY, "/camera", pid=5),
        ManagedNodeChanged(
            stamp_ns=1, unit="/camera", node="/camera", state=ManagedState.CONFIGURING
        ),
        process(ProcessEventKind.EXITED, "/talker"),
    ):
        view = view.after(event)
    assert exit_code(view, view, None) == ExitCode.NODES_MISSING
    for dismissed, code in (("/talker", ExitCode.NODES_MISSING), ("/camera", ExitCode.OK)):
        left = replace(view, dismissed=frozenset({dismissed}))
        assert exit_code(left, left, None) == code
