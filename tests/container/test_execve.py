"""A node that replaces itself by another program has come to its end."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent
from std_msgs.msg import String

from tests.support.isolated import MODES, is_gone, only_these_remain, start, survives

if TYPE_CHECKING:
    from tests.support.control_peer import Container, StartContainer
    from tests.support.ros import Probe

CRASHED, LOAD_FAILED = ComponentEvent.CRASHED, ComponentEvent.LOAD_FAILED

both_modes = pytest.mark.parametrize("mode", MODES)


def ended(container: Container, kind: int) -> ComponentEvent:
    """Ask for the status again and again, as a supervisor does, until such an event came."""
    while True:
        container.status()
        for message in container.seen:
            if isinstance(message, ComponentEvent) and message.event_type == kind:
                assert "it replaced itself by " in message.error_message
                assert "/sleep (execve)" in message.error_message
                return message
        time.sleep(0.2)


@both_modes
def test_a_node_that_becomes_another_program_is_ended(
    spawn: StartContainer, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    with survives(container):
        talker = container.loaded("Talker", parameters={"rate": 100.0})
        vandal = container.loaded("Vandal", parameters={"how": "execve"})
        assert ended(container, CRASHED).unique_id == vandal.unique_id
        assert is_gone(vandal.pid)
        probe.collect(String, "/chatter", 5)
        assert only_these_remain(container, talker.pid)


def test_execve_in_a_constructor_is_a_failed_load(spawn: StartContainer) -> None:
    container = start(spawn)
    with survives(container):
        container.load("Vandal", parameters={"how": "execve", "in_constructor": True})
        ended(container, LOAD_FAILED)


@both_modes
def test_execve_of_nothing_fails_as_always(spawn: StartContainer, mode: str, probe: Probe) -> None:
    container = start(spawn, mode)
    with survives(container):
        vandal = container.loaded("Vandal", parameters={"how": "execve_nothing"})
        probe.collect(String, "/vandal", 5)
        assert only_these_remain(container, vandal.pid)
