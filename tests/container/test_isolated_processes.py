"""Isolated nodes that share no memory: each in a container of its own below the first one."""

from __future__ import annotations

import os
import select
import signal
from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlCancel, ControlUnload
from std_msgs.msg import String

from play_launch.ros.fastdds.shared_memory import sweep
from tests.support.control_peer import PATIENCE
from tests.support.isolated import (
    MODES,
    children,
    is_gone,
    only_these_remain,
    start,
    survives,
)
from tests.support.ros import Probe

if TYPE_CHECKING:
    from tests.support.control_peer import Container, StartContainer

UNLOADED, LOADING = ComponentEvent.UNLOADED, ComponentEvent.LOADING
CRASHED, LOAD_FAILED = ComponentEvent.CRASHED, ComponentEvent.LOAD_FAILED
FOREVER = {"seconds": 3600.0}

both_modes = pytest.mark.parametrize("mode", MODES)


def start_separate(spawn: StartContainer, mode: str = "isolated") -> Container:
    return start(spawn, mode, "--isolation", "process")


@both_modes
def test_every_node_is_a_program(spawn: StartContainer, mode: str) -> None:
    container = start_separate(spawn, mode)
    (hello,) = container.seen
    assert (hello.mode, hello.mechanism) == (mode, "process")
    with survives(container), Probe() as probe:
        talker = container.loaded("Talker", node_name="one", node_namespace="/ns")
        listener = container.loaded("Listener")
        assert talker.full_node_name == "/ns/one"
        assert children(container) == {talker.pid, listener.pid}
        probe.collect(String, "/ns/chatter", 3)
        assert {node.pid for node in container.status().nodes} == {talker.pid, listener.pid}
        container.send(ControlUnload(unique_id=talker.unique_id))
        gone = container.event(UNLOADED, unique_id=talker.unique_id)
        assert (gone.error_message, gone.signal) == ("", 0)
        assert is_gone(talker.pid)
        assert only_these_remain(container, listener.pid)


def test_a_name_that_is_asked_for_is_given_once(spawn: StartContainer) -> None:
    container = start_separate(spawn)
    with survives(container):
        talker = container.loaded("Talker")
        container.load("Talker", node_name="talker")
        failed = container.event(LOAD_FAILED)
        assert failed.error_message.startswith("a node named /talker is loaded")
        assert children(container) == {talker.pid}


@pytest.mark.parametrize(("how", "number"), [("segv", 11), ("kill", 9), ("exit", 0)])
def test_a_crash_is_told(spawn: StartContainer, how: str, number: int) -> None:
    container = start_separate(spawn)
    with survives(container), Probe() as probe:
        talker = container.loaded("Talker")
        crasher = container.loaded("Crasher")
        order = probe.node.create_publisher(String, "/crash", 1)
        probe.spin_until(
            lambda: order.get_subscription_count() > 0, PATIENCE, "the crasher's subscription"
        )
        order.publish(String(data=how))
        crashed = container.event(CRASHED, unique_id=crasher.unique_id)
        assert (crashed.signal, crashed.exit_code) == (number, 0 if number else 3)
        assert (crashed.pid, crashed.start_time) == (crasher.pid, crasher.start_time)
        probe.collect(String, "/chatter", 3)
        assert only_these_remain(container, talker.pid)
        assert container.status().crashes == 1
    sweep()  # as the supervisor does: the dead node's participant was its own


def test_a_helper_that_outlives_its_node_does_not_hide_the_crash(spawn: StartContainer) -> None:
    """It holds the node's end of the channel open."""
    container = start_separate(spawn)
    with survives(container), Probe() as probe:
        forker = container.loaded("Forker")
        (helper,) = children(container) - {forker.pid}
        handle = os.pidfd_open(helper)
        try:
            order = probe.node.create_publisher(String, "/crash", 1)
            probe.spin_until(
                lambda: order.get_subscription_count() > 0, PATIENCE, "the node's subscription"
            )
            order.publish(String())
            crashed = container.event(CRASHED, unique_id=forker.unique_id)
            assert (crashed.pid, crashed.exit_code) == (forker.pid, 3)
            assert not select.select([handle], [], [], 0)[0], "the helper did not outlive its node"
        finally:
            signal.pidfd_send_signal(handle, signal.SIGKILL)
            ended, _, _ = select.select([handle], [], [], PATIENCE)
            os.close(handle)
        assert ended
        assert only_these_remain(container)


def test_what_fails_while_loading(spawn: StartContainer) -> None:
    container = start_separate(spawn)
    with survives(container):
        container.load("ThrowingConstructor")
        assert "no such camera" in container.event(LOAD_FAILED).error_message
        container.load("Crasher", parameters={"in_constructor": True})
        failed = container.event(LOAD_FAILED)
        assert failed.signal == signal.SIGSEGV
        assert "SIGSEGV" in failed.error_message
        assert only_these_remain(container)


def test_a_load_is_cancelled(spawn: StartContainer) -> None:
    container = start_separate(spawn)
    with survives(container):
        container.load("SlowConstructor", parameters={"seconds": 0.3})
        loading = container.event(LOADING)
        container.send(ControlCancel(unique_id=loading.unique_id))
        assert container.event(UNLOADED).error_message == "cancelled"
        assert only_these_remain(container)


def test_the_end_of_the_channel_ends_everything(spawn: StartContainer) -> None:
    container = start_separate(spawn)
    container.loaded("Talker")
    container.load("SlowConstructor", parameters=FOREVER)
    container.event(LOADING, plugin_name="play_launch_demo::SlowConstructor")
    # LOADING is told before the process is there; each answer gives the container a turn.
    for _ in range(1000):
        pids = children(container)
        if len(pids) == 2:
            break
        container.status()
    assert len(pids) == 2
    assert container.peer is not None
    container.peer.close()
    assert container.wait() == 0
    assert all(is_gone(pid) for pid in pids)


def test_a_killed_container_takes_its_nodes_along(spawn: StartContainer) -> None:
    container = start_separate(spawn)
    talker = container.loaded("Talker")
    handle = os.pidfd_open(talker.pid)
    container.process.kill()
    assert container.wait() == -signal.SIGKILL
    try:
        ended, _, _ = select.select([handle], [], [], PATIENCE)
        assert ended
    finally:
        os.close(handle)
