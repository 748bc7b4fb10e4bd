"""Libraries that take long to open, that die in it, or that start threads."""

from __future__ import annotations

import signal

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlCancel, ControlUnload, NodeStatus

from tests.support.control_peer import Container, StartContainer
from tests.support.isolated import ALL_MODES, MODES, start
from tests.support.ros import Probe

LOADED, UNLOADED, CRASHED = (
    ComponentEvent.LOADED,
    ComponentEvent.UNLOADED,
    ComponentEvent.CRASHED,
)
FOR_EVER = {"PLAY_LAUNCH_DEMO_OPENING": "3600"}


def load_slow(container: Container, **fields: object) -> int:
    return container.load(
        "play_launch_demo::SlowLibrary", package="play_launch_demo_slow", **fields
    )


@pytest.fixture(params=ALL_MODES)
def opening(request: pytest.FixtureRequest, spawn: StartContainer) -> Container:
    """Start a container with a talker that will never be done with opening another library."""
    container = start(spawn, request.param, environment=FOR_EVER)
    container.loaded("Talker", node_name="first")
    load_slow(container)
    (waiting,) = (n for n in until_it_waits(container) if n.note)
    assert waiting.state == NodeStatus.CONSTRUCTING
    assert waiting.note.endswith("/lib/libplay_launch_demo_slow.so")
    return container


def until_it_waits(container: Container) -> list[NodeStatus]:
    status = container.status_when(
        lambda status: any(node.note for node in status.nodes), "a node that waits"
    )
    nodes: list[NodeStatus] = status.nodes
    return nodes


def test_nodes_whose_library_is_open_are_loaded_and_unloaded_meanwhile(opening: Container) -> None:
    for plugin in ("Talker", "Listener", "ImageSource", "Echo", "Talker"):
        node = opening.loaded(plugin, node_name="another")
        assert len(opening.status().nodes) == 3
        opening.send(ControlUnload(unique_id=node.unique_id))
        opening.event(UNLOADED, unique_id=node.unique_id)


def test_services_are_offered_while_the_first_library_is_opened(spawn: StartContainer) -> None:
    container = start(spawn, environment=FOR_EVER)
    load_slow(container)
    until_it_waits(container)
    with Probe() as probe:
        assert probe.nodes() == []


def test_a_library_behind_it_waits_and_says_so(opening: Container) -> None:
    attempt = opening.load(
        "play_launch_demo::PoolLibrary", package="play_launch_demo_pool", node_name="behind"
    )
    both = opening.status_when(
        lambda status: sum(bool(node.note) for node in status.nodes) == 2, "the one behind"
    )
    notes = {node.attempt: node.note for node in both.nodes}
    assert notes[attempt].endswith("/lib/libplay_launch_demo_slow.so")


def test_a_refused_library_is_reported_once_it_is_open(spawn: StartContainer) -> None:
    container = start(spawn, environment={"PLAY_LAUNCH_DEMO_OPENING": "0.5"})
    load_slow(container)
    nodes = until_it_waits(container)
    container.send(ControlCancel(unique_id=nodes[0].unique_id))
    assert "cancelled" in container.event(UNLOADED, unique_id=nodes[0].unique_id).error_message
    assert container.status().nodes == []
    container.loaded("play_launch_demo::SlowLibrary", package="play_launch_demo_slow")
    assert container.shut_down() == 0


def test_a_container_that_opens_a_library_stops(opening: Container) -> None:
    assert opening.shut_down() == 0
    assert "/slow_library" in opening.log.read_text() or "SlowLibrary" in opening.log.read_text()
    assert "still waits for the dynamic loader" in opening.log.read_text()


def test_a_crash_is_reported_while_a_library_is_opened(spawn: StartContainer) -> None:
    container = start(spawn, environment=FOR_EVER)
    container.loaded("Talker", node_name="first")
    load_slow(container)
    until_it_waits(container)
    container.loaded("Crasher", parameters={"after": 0.1, "how": "segv"})
    crashed = container.event(CRASHED)
    assert crashed.signal == signal.SIGSEGV
    assert any("play_launch_demo::" in line for line in crashed.backtrace), crashed.backtrace


@pytest.mark.parametrize("mode", ALL_MODES)
@pytest.mark.parametrize(
    ("way", "number", "end"),
    [
        ("segv", signal.SIGSEGV, "SIGSEGV"),
        ("exit", signal.SIGABRT, "an initialiser of it called exit()"),
    ],
)
def test_the_log_names_the_library_that_takes_the_container_down(
    spawn: StartContainer, mode: str, way: str, number: int, end: str
) -> None:
    container = start(spawn, mode, environment={"PLAY_LAUNCH_DEMO_CRASH": way})
    container.load(
        "play_launch_demo::CrashingLibrary",
        package="play_launch_demo_crashing",
        node_name="poisonous",
    )
    assert container.wait() == -number
    (line,) = (x for x in container.log.read_text().splitlines() if "the container ends" in x)
    assert "libplay_launch_demo_crashing.so for node /poisonous" in line
    assert line.endswith(end)


@pytest.mark.parametrize("mode", MODES)
def test_threads_of_a_library_outlive_the_node_that_needed_it_first(
    spawn: StartContainer, mode: str
) -> None:
    container = start(spawn, mode)
    pool = {"package": "play_launch_demo_pool", "plugin": "play_launch_demo::PoolLibrary"}
    container.load(**pool, node_name="dies", parameters={"crash": True})
    assert container.event(CRASHED).full_node_name == "/dies"
    # Its constructor returns when a thread of the library has answered.
    container.loaded(**pool, node_name="lives")
    assert container.shut_down() == 0
