"""A node that replaces itself by another program has come to its end."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent
from std_msgs.msg import String

from tests.support.isolated import (
    MODES,
    is_gone,
    only_these_remain,
    start,
    survives,
)
from tests.support.ros import Probe

if TYPE_CHECKING:
    from tests.support.control_peer import Container, StartContainer

CRASHED, LOAD_FAILED = ComponentEvent.CRASHED, ComponentEvent.LOAD_FAILED
WAYS = ("execve", "execv", "execvp", "execl", "execlp", "execle", "fexecve")

both_modes = pytest.mark.parametrize("mode", MODES)


def assert_replaced(event: ComponentEvent) -> None:
    assert "it replaced itself by " in event.error_message
    assert "/sleep (execve)" in event.error_message


def found_out(container: Container, kind: int) -> ComponentEvent:
    """Ask for the status again and again, as a supervisor does, until such an event came."""
    while True:
        container.status()
        for message in container.seen:
            if isinstance(message, ComponentEvent) and message.event_type == kind:
                return message
        time.sleep(0.2)


@both_modes
@pytest.mark.parametrize("how", WAYS)
def test_execve_ends_the_node_at_once(spawn: StartContainer, mode: str, how: str) -> None:
    container = start(spawn, mode)
    with survives(container), Probe() as probe:
        talker = container.loaded("Talker", parameters={"rate": 100.0})
        vandal = container.loaded("Vandal", parameters={"how": how})
        crashed = container.event(CRASHED, unique_id=vandal.unique_id)
        assert_replaced(crashed)
        assert (crashed.exit_code, crashed.signal) == (0, 0)
        assert is_gone(vandal.pid)
        probe.collect(String, "/chatter", 5)
        assert only_these_remain(container, talker.pid)
        status = container.status()
        assert (status.crashes, status.unquiesced) == (1, 0)


@both_modes
def test_execve_past_the_c_library_is_found_out(spawn: StartContainer, mode: str) -> None:
    container = start(spawn, mode)
    with survives(container), Probe() as probe:
        talker = container.loaded("Talker", parameters={"rate": 100.0})
        vandal = container.loaded("Vandal", parameters={"how": "execve_by_system_call"})
        crashed = found_out(container, CRASHED)
        assert crashed.unique_id == vandal.unique_id
        assert_replaced(crashed)
        assert is_gone(vandal.pid)
        probe.collect(String, "/chatter", 5)
        assert only_these_remain(container, talker.pid)


@pytest.mark.parametrize("how", ["execve", "execve_by_system_call"])
def test_execve_in_a_constructor_is_a_failed_load(spawn: StartContainer, how: str) -> None:
    container = start(spawn)
    with survives(container):
        container.load("Vandal", parameters={"how": how, "in_constructor": True})
        failed = found_out(container, LOAD_FAILED)
        assert_replaced(failed)


@both_modes
def test_execve_of_nothing_fails_as_always(spawn: StartContainer, mode: str) -> None:
    container = start(spawn, mode)
    with survives(container), Probe() as probe:
        vandal = container.loaded("Vandal", parameters={"how": "execve_nothing"})
        probe.collect(String, "/vandal", 5)
        assert only_these_remain(container, vandal.pid)
