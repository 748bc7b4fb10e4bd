"""What did not come up, or left: managed nodes, units that waited, nodes that others unloaded."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from play_launch.cli.explain import headline
from play_launch.postmortem.critical_chain import nodes_of_bring_up
from play_launch.supervisor.events import (
    ContainerState,
    ManagedState,
    NodeState,
    ProcessEventKind,
    SubjectKind,
    Withdrawn,
)
from play_launch.supervisor.outcome import Cause
from tests.postmortem.scenes import Scene, ns, requested

if TYPE_CHECKING:
    from pathlib import Path


def test_a_managed_node_that_was_not_brought_up(tmp_path: Path) -> None:
    scene = Scene()
    scene.started()
    scene.node(0.5, "/lidar", NodeState.LOADED)
    scene.managed(0.6, "/box:/lidar", ManagedState.CONFIGURING)
    scene.line(0.9, "[ERROR] [1.0] [lidar]: no such port")
    why = "its transition configure failed"
    scene.managed(1, "/box:/lidar", ManagedState.FAILED, why)
    scene.line(1.1, "[ERROR] [1.1] [lidar]: given up")
    scene.managed(20, "/box:/lidar", ManagedState.FAILED, why)
    story = scene.story(tmp_path)
    (finding,) = story.findings
    assert (finding.kind, finding.key, finding.cause) == ("not_brought_up", "/box:/lidar", why)
    text = "/lidar in /box was not brought up as a managed node 2 times, first at 1.000 s after"
    assert headline(finding, ns(0)) == f"{text} the start."
    assert (finding.is_failure, finding.state) == (True, "loaded")
    assert len(finding.last_lines) == 2
    assert [event.what for event in story.timeline.events] == ["not brought up"] * 2


@pytest.mark.parametrize("has_codes", [True, False])
@pytest.mark.parametrize("is_dismissed", [False, True])
def test_a_process_that_waited_to_the_end(
    tmp_path: Path, is_dismissed: bool, has_codes: bool
) -> None:
    scene = Scene(has_codes=has_codes)
    scene.started()
    why = "waits for a publisher of /scan"
    scene.process(0.1, ProcessEventKind.WAITING, "/slam", message=why)
    if is_dismissed:
        scene.dismissed(5, "/slam")
    scene.process(9, ProcessEventKind.STOPPED, "/slam", message="signal 2")
    scene.process(0.1, ProcessEventKind.WAITING, "/late", message=why)
    given_up = "it waited for a publisher of /scan: not within 5 s"
    scene.process(5, ProcessEventKind.GAVE_UP, "/late", message=given_up)
    found = scene.story(tmp_path).findings
    waited = [("not_started", "/slam", why)] * (not is_dismissed)
    assert [(each.kind, each.name, each.cause) for each in found] == [
        ("not_started", "/late", given_up),
        *waited,
    ]


@pytest.mark.parametrize(
    "by", ["another program", "play-launch", "a stop of its container", "the end of its container"]
)
def test_a_node_that_was_unloaded(tmp_path: Path, by: str) -> None:
    scene = Scene()
    scene.started()
    scene.node(0.5, "/slam", NodeState.LOADED)
    if by == "play-launch":
        scene.node(2, "/slam", NodeState.UNLOADING)
    if by == "a stop of its container":
        scene.process(2, ProcessEventKind.STOPPING, cause=Cause.STOPPED)
    scene.node(3, "/slam", NodeState.UNLOADED, reason="not at the supervisor's request")
    if by == "the end of its container":
        scene.process(3.1, ProcessEventKind.EXITED)
    found = scene.story(tmp_path).findings
    expected = {
        "another program": [("left", "/slam")],
        "the end of its container": [("died", "/box")],
    }
    assert [(each.kind, each.name) for each in found] == expected.get(by, [])


@pytest.mark.parametrize("state", [NodeState.LOADED, NodeState.LOADING])
def test_a_node_that_was_lost_as_its_container_was_stopped(
    tmp_path: Path, state: NodeState
) -> None:
    scene = Scene()
    scene.started()
    scene.node(0.5, "/slam", state)
    scene.process(2, ProcessEventKind.STOPPING, cause=Cause.STOPPED)
    scene.process(3, ProcessEventKind.EXITED, signal=2, cause=Cause.STOPPED)
    scene.node(3, "/slam", NodeState.LOST, reason="its container: exited with signal 2 (SIGINT)")
    found = scene.story(tmp_path).findings
    missing = [("not_loaded", "loading", (ns(0.5),), "")] * (state is NodeState.LOADING)
    assert [(each.kind, each.state, each.times_ns, each.cause) for each in found] == missing


def test_a_process_that_ended_well_too_often(tmp_path: Path) -> None:
    scene = Scene()
    scene.process(0, ProcessEventKind.STARTED, "/once")
    scene.process(1, ProcessEventKind.EXITED, "/once")
    scene.process(1, ProcessEventKind.GAVE_UP, "/once", message="restart limit reached")
    (finding,) = scene.story(tmp_path).findings
    text = "/once was not started again: it was given up at 1.000 s after the start."
    assert headline(finding, ns(0)) == text


def test_nodes_of_a_container_that_an_operator_stopped_are_not_missing(tmp_path: Path) -> None:
    scene = Scene()
    scene.node(0, "/slam", NodeState.PENDING)
    (finding,) = scene.story(tmp_path).findings
    assert (finding.kind, finding.key) == ("not_loaded", "/box:/slam")
    scene.dismissed(1, "/box")
    assert scene.story(tmp_path).findings == ()


def test_what_ran_counts_after_another_configuration_was_applied(tmp_path: Path) -> None:
    declared = {"full_name": "/sleep", "package": None, "command": ["sleep", "1"], "line": 7}
    scene = Scene(resolved={"source": "robot.yaml", "nodes": [declared]})
    scene.process(1, ProcessEventKind.STARTED, "/sleep", command=("sleep", "2"), pid=5)
    scene.process(2, ProcessEventKind.EXITED, "/sleep", exit_code=3, pid=5)
    (finding,) = scene.story(tmp_path).findings
    assert (finding.place.command, finding.place.config) == (("sleep", "2"), "robot.yaml:7")


def test_a_node_of_a_later_configuration_is_not_late(tmp_path: Path) -> None:
    scene = Scene()
    scene.started()
    for name in ("/a", "/b", "/c", "/gone"):
        scene.node(0, name, NodeState.PENDING)
    for name in ("/a", "/b", "/c"):
        scene.node(0.5, name, NodeState.LOADED)
    scene.events.append(requested(ns(60), "apply", ("/box:/new", "/box:/gone")))
    scene.events.append(Withdrawn(stamp_ns=ns(60), kind=SubjectKind.NODE, key="/box:/gone"))
    scene.node(60, "/new", NodeState.PENDING)
    scene.node(61, "/new", NodeState.LOADED)
    story = scene.story(tmp_path)
    assert story.findings == ()
    assert [unit.name for unit in nodes_of_bring_up(story.timeline)] == ["/a", "/b", "/c"]


@pytest.mark.parametrize("end", ["it dies", "it waits", "it is not ready"])
def test_nodes_of_a_container_that_is_never_ready_are_told_with_it(
    tmp_path: Path, end: str
) -> None:
    scene = Scene()
    for name in ("/slam", "/map"):
        scene.node(0, name, NodeState.PENDING)
    reason = "waits for the file /map" if end == "it waits" else ""
    scene.container(0.1, ContainerState.STARTING, reason=reason)
    if end != "it waits":
        scene.process(0.1, ProcessEventKind.STARTED)
    if end == "it dies":
        scene.process(0.2, ProcessEventKind.EXITED, exit_code=1)
    (finding,) = scene.story(tmp_path).findings
    kind = "died" if end == "it dies" else "not_started"
    assert (finding.kind, finding.key, finding.hit) == (kind, "/box", ("/slam", "/map"))


def test_a_unit_that_was_moved_to_another_machine_has_not_died(tmp_path: Path) -> None:
    scene = Scene()
    scene.process(0, ProcessEventKind.STARTED, pid=5)
    scene.process(1, ProcessEventKind.STOPPING, pid=5, cause=Cause.STOPPED)
    scene.process(1.1, ProcessEventKind.STARTED, pid=9)  # on the other machine
    scene.container(1.2, ContainerState.RUNNING)
    scene.process(1.3, ProcessEventKind.EXITED, pid=5, cause=Cause.STOPPED)
    assert scene.story(tmp_path).findings == ()
