"""An exception that no code of a node catches ends the process where it is thrown."""

from __future__ import annotations

import re
from signal import SIGABRT
from typing import TYPE_CHECKING

import pytest
from play_launch_msgs.msg import ComponentEvent
from std_msgs.msg import String
from std_srvs.srv import Trigger

from play_launch.ros.fastdds.shared_memory import sweep
from tests.support.isolated import MODES, start, survives

if TYPE_CHECKING:
    from tests.support.control_peer import StartContainer
    from tests.support.ros import Probe

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
