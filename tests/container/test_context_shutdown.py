"""A node may end itself, and no other: the ROS context is everybody's in a container."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent

from tests.support.isolated import MODES, only_these_remain, start_isolated, survives

if TYPE_CHECKING:
    from tests.support.control_peer import StartContainer

LOADED, UNLOADED, CRASHED = ComponentEvent.LOADED, ComponentEvent.UNLOADED, ComponentEvent.CRASHED

both_modes = pytest.mark.parametrize("mode", MODES)
ways = pytest.mark.parametrize("how", ["context", "rcl"])
places = pytest.mark.parametrize("where", ["callback", "constructor", "thread"])


@both_modes
@ways
@places
def test_an_isolated_node_ends_alone(
    spawn: StartContainer, mode: str, how: str, where: str
) -> None:
    container = start_isolated(spawn, mode)
    with survives(container):
        talker = container.loaded("Talker")
        quitter = container.loaded("Quitter", parameters={"how": how, "where": where})
        event = container.event(UNLOADED)
        assert event.unique_id == quitter.unique_id
        assert event.full_node_name == "/quitter"
        assert "ended itself" in event.error_message
        assert "context" in event.error_message
        assert only_these_remain(container, talker.pid)
        # The context is what it was: another node is loaded, and may end itself in its turn.
        container.loaded("Listener")
        again = container.loaded("Quitter")
        assert container.event(UNLOADED).unique_id == again.unique_id
        status = container.status()
        assert {node.full_node_name for node in status.nodes} == {"/talker", "/listener"}
        assert status.crashes == 0


def test_a_node_that_does_not_come_to_its_end_is_pressed(spawn: StartContainer) -> None:
    container = start_isolated(spawn)
    with survives(container):
        talker = container.loaded("Talker")
        container.loaded("Quitter", parameters={"lingers": True})
        assert container.event(CRASHED).full_node_name == "/quitter"
        assert only_these_remain(container, talker.pid)


@ways
@places
@pytest.mark.parametrize(
    "arguments", [(), ("--use_multi_threaded_executor",)], ids=["standard", "mt"]
)
def test_a_node_that_shares_its_process_ends_the_container_by_name(
    spawn: StartContainer, arguments: tuple[str, ...], how: str, where: str
) -> None:
    container = spawn(*arguments)
    talker = container.loaded("Talker")
    container.load("Quitter", parameters={"how": how, "where": where}, node_name="quitter")
    event = container.event(UNLOADED, unique_id=talker.unique_id)
    assert container.wait() == 79
    log = container.log.read_text()
    for text in (event.error_message, log):
        assert "shut the ROS context down" in text
        # A thread of its own is known by its library only.
        assert ("libplay_launch_demo" if where == "thread" else "/quitter") in text


def test_a_node_with_memory_of_its_own_ends_alone(spawn: StartContainer) -> None:
    container = spawn("--isolated", "--isolation", "process")
    with survives(container):
        talker = container.loaded("Talker")
        container.load("Quitter")
        event = container.event(UNLOADED)
        assert event.plugin_name.endswith("Quitter")
        assert "/quitter shut the ROS context down" in event.error_message
        assert only_these_remain(container, talker.pid)
