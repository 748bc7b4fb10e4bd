"""Isolated nodes that share no memory: each in a container of its own below the first one."""

from __future__ import annotations

import os
import select
import signal
from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent
from std_msgs.msg import String

from play_launch.ros.fastdds.shared_memory import sweep
from tests.support.control_peer import PATIENCE
from tests.support.isolated import (
    children,
    only_these_remain,
    start,
    survives,
)
from tests.support.ros import Probe

if TYPE_CHECKING:
    from tests.support.control_peer import Container, StartContainer

CRASHED, LOAD_FAILED = ComponentEvent.CRASHED, ComponentEvent.LOAD_FAILED


def start_separate(spawn: StartContainer, mode: str = "isolated") -> Container:
    return start(spawn, mode, "--isolation", "process")


@pytest.mark.parametrize(("how", "number"), [("segv", 11), ("kill", 9), ("exit", 0)])
def test_a_crash_is_told(spawn: StartContainer, package: str, how: str, number: int) -> None:
    container = start_separate(spawn)
    with survives(container), Probe() as probe:
        talker = container.loaded("Talker", package=package)
        crasher = container.loaded("Crasher", package=package)
        assert len({talker.pid, crasher.pid, container.process.pid}) == 3
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
