"""However the container is asked to stop, it does, and leaves nothing behind."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlShutdown

from tests.support.shared_memory import segments_of

if TYPE_CHECKING:
    from tests.support.control_peer import Container, StartContainer

UNLOADED, LOADING = ComponentEvent.UNLOADED, ComponentEvent.LOADING
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


@pytest.mark.parametrize("mode", [(), ("--use_multi_threaded_executor",)], ids=["standard", "mt"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_unloads_everything(
    spawn: StartContainer, number: signal.Signals, mode: tuple[str, ...]
) -> None:
    container = spawn(*mode)
    ids = {container.loaded(plugin).unique_id for plugin in ("Talker", "Listener", "Echo")}
    own = segments_of([container.process.pid])
    assert own
    container.process.send_signal(number)
    assert {container.event(UNLOADED).unique_id for _ in ids} == ids
    assert container.wait() == 0
    assert not any(path.exists() for path in own)


def test_a_shutdown_unloads_everything(spawn: StartContainer) -> None:
    container = spawn()
    ids = {container.loaded(plugin).unique_id for plugin in ("Talker", "Listener")}
    container.send(ControlShutdown(reason="enough"))
    assert {container.event(UNLOADED).unique_id for _ in ids} == ids
    with pytest.raises(EOFError):
        container.receive()
    assert container.wait() == 0


def test_a_container_without_control_channel_stops_too(spawn: StartContainer) -> None:
    container = spawn(control=False)
    while not catches(container, signal.SIGTERM):
        assert container.process.poll() is None
    container.process.send_signal(signal.SIGTERM)
    assert container.wait() == 0


@pytest.mark.alone
@pytest.mark.parametrize("busy", [False, True], ids=["idle", "constructing"])
def test_the_end_of_the_channel_ends_the_container(spawn: StartContainer, busy: bool) -> None:
    container = spawn()
    container.loaded("Talker")
    if busy:
        container.load("SlowConstructor", parameters=FOREVER)
        container.event(LOADING, plugin_name="play_launch_demo::SlowConstructor")
    own = segments_of([container.process.pid])
    assert container.peer is not None
    container.peer.close()
    assert container.wait(timeout=60.0) == 0
    assert not any(path.exists() for path in own)


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
