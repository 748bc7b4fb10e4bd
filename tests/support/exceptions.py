"""Nodes that throw something that nobody catches."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from signal import SIGABRT

from play_launch_msgs.msg import ComponentEvent
from std_msgs.msg import String
from std_srvs.srv import Trigger

from play_launch.ros.fastdds.shared_memory import sweep
from tests.support.control_peer import Container
from tests.support.ros import Probe

THROWERS = ("throw_here", "throw_below", "throw_far_below")
"""The functions of the way `deep_exception` of the component Crasher, innermost first."""
TEXT = "thrown some functions below the callback, on purpose"
LINE = f"a callback of node /crasher threw: {TEXT}"
"""What the container writes."""


def send_message(probe: Probe) -> None:
    """Have it throw in a subscription's callback."""
    publisher = probe.node.create_publisher(String, "/crash", 1)
    probe.spin_until(
        lambda: publisher.get_subscription_count() > 0, 30.0, "the crasher's subscription"
    )
    publisher.publish(String(data="deep_exception"))


def send_request(probe: Probe) -> None:
    """Have it throw in a service's callback."""
    probe.start_call(Trigger, "/die", Trigger.Request(), timeout=60.0)


CALLBACKS: dict[str, tuple[float, Callable[[Probe], None] | None]] = {
    "timer": (0.0, None),
    "subscription": (-1.0, send_message),
    "service": (-1.0, send_request),
}
"""The parameter `after` of the Crasher, and what else makes it throw."""


def crasher_is_reported(container: Container, unique_id: int) -> None:
    """The isolated Crasher ends; event and log name the exception and who threw it."""
    crashed = container.event(ComponentEvent.CRASHED, unique_id=unique_id)
    assert crashed.signal == SIGABRT
    assert f"std::runtime_error: {TEXT}" in crashed.error_message
    assert names_throwers(crashed.backtrace), crashed.backtrace
    assert LINE in container.log.read_text()


def crasher_ends_its_container(container: Container) -> None:
    """The container dies of the exception, and its log names the node."""
    assert container.wait() == -SIGABRT
    assert LINE in container.log.read_text()
    sweep()


def names_throwers(backtrace: Sequence[str]) -> bool:
    """Whether the frames begin with the functions that threw, innermost first."""
    return len(backtrace) > len(THROWERS) and all(
        re.match(rf"#{i} .*\b{name}\(", backtrace[i]) for i, name in enumerate(THROWERS)
    )
