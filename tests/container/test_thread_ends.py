"""What a node leaves with its first thread is destroyed in the node, and nowhere else."""

from __future__ import annotations

from signal import SIGABRT, SIGSEGV, SIGTERM, Signals
from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlUnload
from std_msgs.msg import String

from tests.support.isolated import only_these_remain, start, survives
from tests.support.ros import Probe

if TYPE_CHECKING:
    from tests.support.control_peer import Container, StartContainer

UNLOADED, CRASHED = ComponentEvent.UNLOADED, ComponentEvent.CRASHED
DEEDS = {
    "fault": (CRASHED, SIGSEGV, "no memory at address 0x0"),
    "throw": (CRASHED, SIGABRT, "thrown by a destructor on purpose"),
    "loop": (UNLOADED, SIGTERM, "a destructor of a thread-local object did not end in time"),
}
"""The event, the signal and the reason that follow from each."""


def unload(container: Container, unique_id: int, end: int = UNLOADED) -> ComponentEvent:
    container.send(ControlUnload(unique_id=unique_id))
    return container.event(end, unique_id=unique_id)


def assert_told(event: ComponentEvent, deed: str) -> None:
    _, number, reason = DEEDS[deed]
    assert event.signal == number
    assert Signals(number).name in event.error_message
    assert reason in event.error_message
    assert any("play_launch_demo::" in line for line in event.backtrace), event.backtrace


@pytest.mark.parametrize(
    ("mode", "leftover", "deed"),
    [
        ("isolated", "object", "fault"),
        ("isolated_mt", "value", "fault"),
        ("isolated", "value", "throw"),
        ("isolated_mt", "object", "loop"),
    ],
)
def test_a_destructor_of_an_unloaded_node_ends_that_node_only(
    spawn: StartContainer, mode: str, leftover: str, deed: str
) -> None:
    container = start(spawn, mode)
    with survives(container), Probe() as probe:
        neighbour = container.loaded("Talker", parameters={"rate": 100.0})
        node = container.loaded("Leftovers", parameters={leftover: deed})
        assert_told(unload(container, node.unique_id, DEEDS[deed][0]), deed)
        # The same name again, in the same container.
        again = container.loaded("Leftovers", parameters={leftover: "nothing"})
        event = unload(container, again.unique_id)
        assert (event.signal, event.error_message) == (0, "")
        probe.collect(String, "/chatter", 3)
        assert only_these_remain(container, neighbour.pid)


@pytest.mark.parametrize("who", ["self", "other"])
def test_a_cancelled_first_thread_is_the_end_of_its_node(spawn: StartContainer, who: str) -> None:
    container = start(spawn)
    with survives(container), Probe() as probe:
        neighbour = container.loaded("Talker", parameters={"rate": 100.0})
        for _ in range(2):
            node = container.loaded("Leftovers", parameters={"cancel": who})
            event = container.event(CRASHED, unique_id=node.unique_id)
            assert (event.signal, event.exit_code) == (0, 0)
            assert "pthread_cancel() of the first thread was called" in event.error_message
        probe.collect(String, "/chatter", 3)
        assert only_these_remain(container, neighbour.pid)
