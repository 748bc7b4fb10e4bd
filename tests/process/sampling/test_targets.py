"""Which processes are measured follows from the view alone."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from play_launch.config.node_key import NodeKey
from play_launch.process.sampling.processes import Target, targets
from play_launch.supervisor.events import (
    ContainerState,
    ContainerStateChanged,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
    SubjectKind,
)
from play_launch.supervisor.view import SystemView
from tests.recording.test_states import EVENTS


def view_of(*events: RunEvent) -> SystemView:
    view = SystemView()
    for event in events:
        view = view.after(event)
    return view


def started(name: str, pid: int) -> ProcessEvent:
    return ProcessEvent(
        stamp_ns=1, kind=ProcessEventKind.STARTED, name=name, pid=pid, start_time=pid + 1000
    )


def box(mechanism: str) -> ContainerStateChanged:
    return ContainerStateChanged(
        stamp_ns=1, container="/box", state=ContainerState.RUNNING, mechanism=mechanism
    )


def node(state: NodeState, pid: int, name: str = "/talker") -> NodeStateChanged:
    key = NodeKey("/box", name)
    return NodeStateChanged(stamp_ns=1, key=key, state=state, pid=pid, start_time=pid + 1000)


CONTAINER = Target(SubjectKind.CONTAINER, "/box", 7, 1007)


def test_nodes_with_memory_of_their_own_are_measured_by_themselves() -> None:
    view = view_of(box("process"), started("/box", 7), node(NodeState.LOADING, 8))
    assert targets(view) == [CONTAINER, Target(SubjectKind.NODE, "/box:/talker", 8, 1008)]


def test_nodes_of_a_container_that_stops_are_not_taken_for_processes_of_their_own() -> None:
    view = view_of(box("shared_memory"), started("/box", 7), node(NodeState.LOADED, 8))
    stopping = ContainerStateChanged(
        stamp_ns=1, container="/box", state=ContainerState.STOPPING, mechanism=""
    )
    assert targets(view.after(stopping)) == [CONTAINER]


def test_a_crashed_node_has_no_process_though_its_pid_is_known() -> None:
    view = view_of(box("shared_memory"), started("/box", 7), node(NodeState.CRASHED, 8))
    assert targets(view) == [CONTAINER]


@settings(max_examples=200)
@given(st.lists(EVENTS, max_size=30))
def test_whatever_happened_memory_is_shared_with_a_container_that_is_measured_before(
    events: list[RunEvent],
) -> None:
    measured: dict[int, Target] = {}
    for target in targets(view_of(*events)):
        assert target.pid
        if target.memory_of:
            assert measured[target.memory_of].kind is SubjectKind.CONTAINER
        measured[target.pid] = target
