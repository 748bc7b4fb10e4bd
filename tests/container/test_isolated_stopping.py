"""However an isolated container or a node of it is stopped, nothing stays behind."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlShutdown, ControlUnload

from tests.support.control_peer import PAUSE
from tests.support.isolated import (
    MODES,
    children,
    is_gone,
    only_these_remain,
    start,
    survives,
)
from tests.support.shared_memory import segments_of

if TYPE_CHECKING:
    from tests.support.control_peer import StartContainer

UNLOADED, LOADING = ComponentEvent.UNLOADED, ComponentEvent.LOADING
FOREVER = {"seconds": 3600.0}

both_modes = pytest.mark.parametrize("mode", MODES)

# A finished thread or two may wait to be joined at any moment; growth would be dozens.
MOMENTARY = 2


def assert_nothing_left(pids: set[int], shared: set[Path]) -> None:
    # The kernel kills what is left of the children with the container, not before.
    deadline = time.monotonic() + 5.0
    while not all(is_gone(pid) for pid in pids):
        assert time.monotonic() < deadline, pids
        time.sleep(PAUSE)
    assert not any(path.exists() for path in shared)


@both_modes
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT, None])
def test_a_stop_unloads_everything(
    spawn: StartContainer, mode: str, how: signal.Signals | None
) -> None:
    container = start(spawn, mode)
    ids = {container.loaded(plugin).unique_id for plugin in ("Talker", "Listener", "Echo")}
    pids, shared = children(container), segments_of([container.process.pid])
    assert len(pids) == 3
    if how is None:
        container.send(ControlShutdown(reason="enough"))
    else:
        container.process.send_signal(how)
    events = [container.event(UNLOADED) for _ in ids]
    assert {event.unique_id for event in events} == ids
    assert not any(event.error_message for event in events)
    assert container.wait() == 0
    assert all(is_gone(pid) for pid in pids)
    assert not any(path.exists() for path in shared)


@both_modes
@pytest.mark.parametrize("busy", [False, True], ids=["idle", "constructing"])
def test_the_end_of_the_channel_ends_everything(
    spawn: StartContainer, mode: str, busy: bool
) -> None:
    container = start(spawn, mode)
    container.loaded("Talker")
    if busy:
        container.load("SlowConstructor", parameters=FOREVER)
        container.event(LOADING, plugin_name="play_launch_demo::SlowConstructor")
        container.status()
    pids, shared = children(container), segments_of([container.process.pid])
    assert shared
    assert container.peer is not None
    container.peer.close()
    assert container.wait() == 0
    assert_nothing_left(pids, shared)


def test_a_constructor_that_does_not_return_is_cut_off(spawn: StartContainer) -> None:
    container = start(spawn, "isolated", "--stop_timeout", "1")
    container.loaded("Talker")
    container.load("SlowConstructor", parameters=FOREVER, node_name="sleeper")
    container.event(LOADING, full_node_name="/sleeper")
    container.status_when(
        lambda status: all(node.pid != container.process.pid for node in status.nodes), "a process"
    )
    pids, shared = children(container), segments_of([container.process.pid])
    container.process.send_signal(signal.SIGTERM)
    gone = container.event(UNLOADED, full_node_name="/sleeper")
    assert gone.signal in {signal.SIGTERM, signal.SIGKILL}
    assert container.wait() == 0
    assert_nothing_left(pids, shared)


@both_modes
def test_a_killed_container_takes_its_nodes_along(spawn: StartContainer, mode: str) -> None:
    container = start(spawn, mode)
    container.loaded("Talker")
    container.load("SlowConstructor", parameters=FOREVER)
    container.event(LOADING, plugin_name="play_launch_demo::SlowConstructor")
    container.status()
    pids = children(container)
    container.process.kill()
    assert container.wait() == -signal.SIGKILL
    assert_nothing_left(pids, set())


@both_modes
def test_a_node_that_does_not_leave_is_ended(spawn: StartContainer, mode: str) -> None:
    container = start(spawn, mode, failpoints="container.before_unload=hang")
    with survives(container):
        stuck = container.loaded("Talker", node_name="stuck")
        container.send(ControlUnload(unique_id=stuck.unique_id))
        gone = container.event(UNLOADED, unique_id=stuck.unique_id)
        assert gone.signal == signal.SIGTERM
        assert "leave" in gone.error_message
        assert is_gone(stuck.pid)
        container.status_when(lambda status: status.undertaken > 0, "the burial")


def test_reloading_leaves_nothing_behind(spawn: StartContainer) -> None:
    container = start(spawn)
    used: list[tuple[int, int]] = []
    with survives(container):
        for _ in range(100):
            node = container.loaded("Talker")
            container.send(ControlUnload(unique_id=node.unique_id))
            container.event(UNLOADED, unique_id=node.unique_id)
            used.append((container.threads(), container.descriptors()))
        for each in (0, 1):
            assert (
                median(u[each] for u in used[50:])
                <= median(u[each] for u in used[5:50]) + MOMENTARY
            ), used
        assert only_these_remain(container)
