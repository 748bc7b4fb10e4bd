"""A node that replaces, cancels or shuts itself down, or throws, ends itself and no other."""

from __future__ import annotations

import os
import re
import time
from signal import SIGABRT, SIGINT, SIGTERM

import pytest
from play_launch_msgs.msg import ComponentEvent, ControlUnload
from std_msgs.msg import String
from std_srvs.srv import Trigger

from play_launch.ros.fastdds.shared_memory import sweep
from tests.support.control_peer import Container, StartContainer
from tests.support.isolated import MODES, is_gone, only_these_remain, start, survives
from tests.support.ros import Probe

CRASHED, LOAD_FAILED = ComponentEvent.CRASHED, ComponentEvent.LOAD_FAILED
UNLOADED = ComponentEvent.UNLOADED

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


@pytest.mark.parametrize("thread", ["self", "other"])
def test_a_cancelled_first_thread_is_the_end_of_its_node(
    spawn: StartContainer, thread: str
) -> None:
    container = start(spawn)
    with survives(container), Probe() as probe:
        neighbour = container.loaded("Talker", parameters={"rate": 100.0})
        for _ in range(2):
            node = container.loaded("Leftovers", parameters={"cancel": thread})
            event = container.event(CRASHED, unique_id=node.unique_id)
            assert (event.signal, event.exit_code) == (0, 0)
            assert "pthread_cancel() of the first thread was called" in event.error_message
        probe.collect(String, "/chatter", 3)
        assert only_these_remain(container, neighbour.pid)


THROWERS = ("throw_here", "throw_below", "throw_far_below")
"""The functions of the way `deep_exception` of the component Crasher, innermost first."""
TEXT = "thrown some functions below the callback, on purpose"
LINE = f"a callback of node /crasher threw: {TEXT}"
"""What the container writes."""


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("callback", ["timer", "subscription", "service"])
def test_the_backtrace_names_the_thrower(
    spawn: StartContainer, package: str, mode: str, callback: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    throwing = {"how": "deep_exception", "after": 0.0 if callback == "timer" else -1.0}
    with survives(container):
        crasher = container.loaded("Crasher", package=package, parameters=throwing)
        if callback == "subscription":
            publisher = probe.node.create_publisher(String, "/crash", 1)
            probe.spin_until(
                lambda: publisher.get_subscription_count() > 0, 30.0, "the subscription"
            )
            publisher.publish(String(data="deep_exception"))
        elif callback == "service":
            probe.start_call(Trigger, "/die", Trigger.Request())
        crashed = container.event(ComponentEvent.CRASHED, unique_id=crasher.unique_id)
        assert crashed.signal == SIGABRT
        assert f"std::runtime_error: {TEXT}" in crashed.error_message
        for i, name in enumerate(THROWERS):
            assert re.match(rf"#{i} .*\b{name}\(", crashed.backtrace[i]), crashed.backtrace
        assert LINE in container.log.read_text()


@pytest.mark.parametrize("mode", ["standard", "mt"])
def test_a_shared_container_names_the_node_that_ends_it(
    spawn: StartContainer, package: str, mode: str
) -> None:
    container = start(spawn, mode)
    throwing = {"how": "deep_exception", "after": 0.0}
    container.load("Crasher", package=package, parameters=throwing)
    assert container.wait() == -SIGABRT
    assert LINE in container.log.read_text()
    sweep()


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
        assert ("libplay_launch_test_components" if where == "thread" else "/quitter") in text


def test_a_node_with_memory_of_its_own_ends_alone(spawn: StartContainer) -> None:
    container = spawn("--isolated", "--isolation", "process")
    with survives(container):
        talker = container.loaded("Talker")
        container.load("Quitter")
        event = container.event(UNLOADED)
        assert event.plugin_name.endswith("Quitter")
        assert "/quitter shut the ROS context down" in event.error_message
        assert only_these_remain(container, talker.pid)


@pytest.mark.parametrize("number", [SIGTERM, SIGINT])
def test_a_node_with_memory_of_its_own_that_is_stopped_has_crashed(
    spawn: StartContainer, number: int
) -> None:
    container = spawn("--isolated", "--isolation", "process")
    with survives(container):
        talker = container.loaded("Talker")
        os.kill(talker.pid, number)
        event = container.event(CRASHED, unique_id=talker.unique_id)
        assert "stopped from outside" in event.error_message
        assert only_these_remain(container)


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
