"""However the container is asked to stop, it does, and leaves nothing behind."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlShutdown, ControlUnload

from tests.support.control_peer import PAUSE, Container, StartContainer
from tests.support.isolated import (
    MODES,
    children,
    is_gone,
    start,
    survives,
)
from tests.support.shared_memory import segments_of

CRASHED, UNLOADED = ComponentEvent.CRASHED, ComponentEvent.UNLOADED
LOADING = ComponentEvent.LOADING
FOREVER = {"seconds": 3600.0}


def catches(container: Container, number: signal.Signals) -> bool:
    """Whether the container has a handler for that signal."""
    status = Path(f"/proc/{container.process.pid}/status").read_text()
    mask = int(status.split("SigCgt:")[1].split()[0], 16)
    return bool(mask & 1 << (number - 1))


def pending(container: Container, number: signal.Signals) -> bool:
    """Whether that signal waits for one of the container's threads to take it."""
    status = Path(f"/proc/{container.process.pid}/status").read_text()
    masks = [int(line.split()[1], 16) for line in status.splitlines() if "Pnd:" in line]
    return any(mask & 1 << (number - 1) for mask in masks)


def assert_nothing_left(pids: set[int], shared: set[Path]) -> None:
    # The kernel kills what is left of the children with the container, not before.
    deadline = time.monotonic() + 5.0
    while not all(is_gone(pid) for pid in pids):
        assert time.monotonic() < deadline, pids
        time.sleep(PAUSE)
    assert not any(path.exists() for path in shared)


@pytest.mark.parametrize(
    ("mode", "how"),
    [
        ("standard", signal.SIGINT),
        ("standard", None),
        ("mt", signal.SIGHUP),
        ("isolated", signal.SIGTERM),
        ("isolated", signal.SIGHUP),
        ("isolated_mt", signal.SIGINT),
        ("isolated_mt", None),
    ],
)
def test_a_stop_unloads_everything(
    spawn: StartContainer, mode: str, how: signal.Signals | None
) -> None:
    container = start(spawn, mode)
    ids = {container.loaded(plugin).unique_id for plugin in ("Talker", "Listener", "Echo")}
    pids, own = children(container), segments_of([container.process.pid])
    assert own
    assert len(pids) == (3 if mode in MODES else 0)
    if how is None:
        container.send(ControlShutdown(reason="enough"))
    else:
        container.process.send_signal(how)
    events = [container.event(UNLOADED) for _ in ids]
    assert {event.unique_id for event in events} == ids
    assert not any(event.error_message for event in events)
    if how is None:
        with pytest.raises(EOFError):
            container.receive()
    assert container.wait() == 0
    assert_nothing_left(pids, own)


def test_a_stop_amid_the_cleanup_after_a_crash_ends_with_it(spawn: StartContainer) -> None:
    container = start(spawn, failpoints="container.during_cleanup=delay:300")
    os.kill(container.loaded("Talker").pid, signal.SIGKILL)
    container.event(CRASHED)
    assert container.shut_down() == 0
    assert "takes too long" not in container.log.read_text()


def test_a_container_without_control_channel_stops_too(spawn: StartContainer) -> None:
    container = spawn(control=False)
    while not catches(container, signal.SIGTERM):
        assert container.process.poll() is None
    container.process.send_signal(signal.SIGTERM)
    assert container.wait() == 0


@pytest.mark.parametrize(
    ("mode", "mechanism"),
    [
        ("standard", "shared_memory"),
        ("isolated", "shared_memory"),
        ("isolated_mt", "shared_memory"),
        ("isolated", "process"),
    ],
)
@pytest.mark.parametrize("busy", [False, True], ids=["idle", "constructing"])
def test_the_end_of_the_channel_ends_everything(
    spawn: StartContainer, mode: str, mechanism: str, busy: bool
) -> None:
    container = start(spawn, mode, "--isolation", mechanism)
    container.loaded("Talker")
    if busy:
        container.load("SlowConstructor", parameters=FOREVER)
        container.event(LOADING, plugin_name="play_launch_demo::SlowConstructor")
        if mode in MODES:
            container.status_when(
                lambda status: all(each.pid != container.process.pid for each in status.nodes),
                "processes of their own",
            )
    pids, own = children(container), segments_of([container.process.pid])
    assert own
    assert container.peer is not None
    container.peer.close()
    assert container.wait() == 0
    assert_nothing_left(pids, own)


def test_the_channel_may_end_before_the_hello(spawn: StartContainer) -> None:
    container = spawn(greet=False, failpoints="container.before_hello=hang")
    while "before_hello" not in container.log.read_text():
        assert container.process.poll() is None
    assert container.peer is not None
    container.peer.close()
    assert container.wait(timeout=60.0) == 0
    assert "the channel to the supervisor has ended" in container.log.read_text()


def test_a_constructor_that_does_not_return_is_named_and_left(spawn: StartContainer) -> None:
    container = spawn("--stop_timeout", "0.2")
    talker = container.loaded("Talker")
    container.load("SlowConstructor", parameters=FOREVER, node_name="sleeper")
    container.event(LOADING, full_node_name="/sleeper")
    own = segments_of([container.process.pid])
    container.process.send_signal(signal.SIGTERM)
    container.event(UNLOADED, unique_id=talker.unique_id)
    assert container.wait() == 0
    log = container.log.read_text()
    assert "/sleeper" in log
    assert "constructor" in log
    assert not any(path.exists() for path in own)


def test_a_second_signal_hurries(spawn: StartContainer) -> None:
    container = spawn("--stop_timeout", "3600")
    talker = container.loaded("Talker")
    container.load("SlowConstructor", parameters=FOREVER)
    container.event(LOADING, plugin_name="play_launch_demo::SlowConstructor")
    container.process.send_signal(signal.SIGINT)
    container.event(UNLOADED, unique_id=talker.unique_id)
    container.process.send_signal(signal.SIGINT)
    assert container.wait() == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_third_signal_ends_it_at_once_and_leaves_no_shared_memory(
    spawn: StartContainer, number: signal.Signals
) -> None:
    container = spawn("--stop_timeout", "3600", failpoints="container.during_stop=hang")
    container.loaded("Talker")
    own = segments_of([container.process.pid])
    assert own
    for _ in range(2):
        container.process.send_signal(number)
        # One that is still pending would swallow the next one.
        while pending(container, number):
            assert container.process.poll() is None
    container.process.send_signal(number)
    assert container.wait() == 128 + number
    assert not any(path.exists() for path in own)


def test_a_hanging_unload_is_left(spawn: StartContainer) -> None:
    container = spawn("--stop_timeout", "0.2", failpoints="container.before_unload=hang")
    container.loaded("Talker", node_name="stuck")
    container.process.send_signal(signal.SIGTERM)
    assert container.wait() == 0
    assert "/stuck" in container.log.read_text()


def test_a_hanging_stop_is_cut_off(spawn: StartContainer) -> None:
    container = spawn("--stop_timeout", "0.1", failpoints="container.during_stop=hang")
    container.process.send_signal(signal.SIGTERM)
    assert container.wait() == 0
    assert "too long" in container.log.read_text()


def test_nothing_is_loaded_while_it_stops(spawn: StartContainer) -> None:
    container = spawn()
    container.load("SlowConstructor", parameters={"seconds": 0.5})
    container.event(LOADING)
    container.send(ControlShutdown(reason="enough"))
    attempt = container.load("Talker")
    rejected = container.until(lambda m: getattr(m, "attempt", 0) == attempt, "an answer")
    assert "stopping" in getattr(rejected, "reason", ""), rejected
    assert container.event(UNLOADED).error_message == "cancelled"
    assert container.wait() == 0


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


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("mechanism", ["shared_memory", "process"])
def test_a_killed_container_takes_its_nodes_along(
    spawn: StartContainer, mode: str, mechanism: str
) -> None:
    container = start(spawn, mode, "--isolation", mechanism)
    container.loaded("Talker")
    container.load("SlowConstructor", parameters=FOREVER)
    container.event(LOADING, plugin_name="play_launch_demo::SlowConstructor")
    container.status()
    pids = children(container)
    container.process.kill()
    assert container.wait() == -signal.SIGKILL
    assert_nothing_left(pids, set())


@pytest.mark.parametrize("mode", MODES)
def test_a_node_that_does_not_leave_is_ended(spawn: StartContainer, mode: str) -> None:
    container = start(spawn, mode, failpoints="container.before_unload=hang")
    with survives(container):
        stuck = container.loaded("Talker", node_name="stuck")
        container.send(ControlUnload(unique_id=stuck.unique_id))
        gone = container.event(UNLOADED, unique_id=stuck.unique_id)
        assert gone.signal == signal.SIGTERM
        assert "leave" in gone.error_message
        assert is_gone(stuck.pid)
        container.status_when(lambda status: status.undertaken > 0, "the cleanup")


def test_after_a_cleanup_that_failed_during_the_stop_no_exit_handlers_run(
    spawn: StartContainer,
) -> None:
    """They might wait for a lock of the dead, when nothing limits the stop any more."""
    environment = {"PLAY_LAUNCH_DEMO_OPENING": "0", "PLAY_LAUNCH_DEMO_CLOSING": "3600"}
    failpoints = "container.during_cleanup=hang"
    container = start(spawn, failpoints=failpoints, environment=environment)
    container.loaded("play_launch_demo::SlowLibrary", package="play_launch_demo_slow")
    os.kill(container.loaded("Talker").pid, signal.SIGKILL)
    container.event(CRASHED)
    assert container.shut_down() == 0
    assert "could not clean up" in container.log.read_text()
