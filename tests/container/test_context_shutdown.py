"""A node may end itself, and no other: the ROS context is everybody's in a container."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent
from std_msgs.msg import String

from tests.support.isolated import MODES, only_these_remain, start, survives

if TYPE_CHECKING:
    from tests.support.control_peer import StartContainer
    from tests.support.ros import Probe

UNLOADED, CRASHED = ComponentEvent.UNLOADED, ComponentEvent.CRASHED
LOAD_FAILED = ComponentEvent.LOAD_FAILED

both_modes = pytest.mark.parametrize("mode", MODES)


@pytest.mark.parametrize(
    ("mode", "how", "where"),
    [
        ("isolated", "context", "callback"),
        ("isolated_mt", "context", "constructor"),
        ("isolated", "rcl", "constructor"),
        ("isolated_mt", "rcl", "thread"),
    ],
)
def test_an_isolated_node_ends_alone(
    spawn: StartContainer, mode: str, how: str, where: str
) -> None:
    container = start(spawn, mode)
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
    container = start(spawn)
    with survives(container):
        talker = container.loaded("Talker")
        container.loaded("Quitter", parameters={"lingers": True})
        assert container.event(CRASHED).full_node_name == "/quitter"
        assert only_these_remain(container, talker.pid)


@pytest.mark.parametrize(
    ("mode", "how", "where"),
    [
        ("standard", "context", "callback"),
        ("mt", "context", "constructor"),
        ("standard", "rcl", "constructor"),
        ("mt", "rcl", "thread"),
    ],
)
def test_a_node_that_shares_its_process_ends_the_container_by_name(
    spawn: StartContainer, mode: str, how: str, where: str
) -> None:
    container = start(spawn, mode)
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


@both_modes
@pytest.mark.parametrize(
    ("how", "in_constructor"),
    [("shutdown", False), ("shutdown", True), ("shutdown_context", False)],
)
def test_a_node_of_rclcpp_ends_alone(
    spawn: StartContainer, components: str, mode: str, how: str, in_constructor: bool, probe: Probe
) -> None:
    container = start(spawn, mode)
    with survives(container):
        container.loaded("Talker", package=components)
        parameters = {"how": how, "after": 0.001, "in_constructor": in_constructor}
        crasher = container.loaded("Crasher", package=components, parameters=parameters)
        event = container.event(UNLOADED, unique_id=crasher.unique_id)
        assert "ended itself" in event.error_message
        if how == "shutdown_context":
            # rclcpp cannot be kept from its work there but by an exception.
            dying = {"how": how, "in_constructor": True}
            container.load("Crasher", package=components, parameters=dying)
            assert "ends alone" in container.event(LOAD_FAILED).error_message
        probe.collect(String, "/chatter", 5)
        assert container.status().crashes == 0


@pytest.mark.parametrize("mode", ["standard", "mt"])
@pytest.mark.parametrize("how", ["shutdown", "shutdown_context"])
def test_a_node_that_shuts_rclcpp_down_ends_a_shared_container(
    spawn: StartContainer, components: str, mode: str, how: str
) -> None:
    container = start(spawn, mode)
    talker = container.loaded("Talker", package=components)
    container.load("Crasher", package=components, parameters={"how": how, "after": 0.001})
    event = container.event(UNLOADED, unique_id=talker.unique_id)
    assert "/crasher shut the ROS context down" in event.error_message
    assert container.wait() == 79, container.log.read_text()
