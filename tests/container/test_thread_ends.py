"""What a node leaves with its first thread is never destroyed, and its container lives on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlUnload
from std_msgs.msg import String

from tests.support.isolated import only_these_remain, start, survives
from tests.support.ros import Probe

if TYPE_CHECKING:
    from tests.support.control_peer import StartContainer

UNLOADED, CRASHED = ComponentEvent.UNLOADED, ComponentEvent.CRASHED


@pytest.mark.parametrize(
    ("mode", "leftover", "deed"),
    [
        ("isolated", "object", "fault"),
        ("isolated_mt", "value", "fault"),
        ("isolated", "value", "throw"),
        ("isolated_mt", "object", "loop"),
    ],
)
def test_a_node_is_unloaded_without_these_destructors(
    spawn: StartContainer, mode: str, leftover: str, deed: str
) -> None:
    container = start(spawn, mode)
    with survives(container), Probe() as probe:
        neighbour = container.loaded("Talker", parameters={"rate": 100.0})
        # The same name again, in the same container.
        for _ in range(2):
            node = container.loaded("Leftovers", parameters={leftover: deed})
            container.send(ControlUnload(unique_id=node.unique_id))
            event = container.event(UNLOADED, unique_id=node.unique_id)
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
