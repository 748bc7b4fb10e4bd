"""Nodes that throw something that nobody catches."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from std_msgs.msg import String
from std_srvs.srv import Trigger

from tests.support.ros import Probe

THROWERS = ("throw_here", "throw_below", "throw_far_below")
"""The functions of the way `deep_exception` of the component Crasher, innermost first."""
TEXT = "thrown some functions below the callback, on purpose"


def send_message(probe: Probe) -> None:
    """Have it throw in a subscription's callback."""
    publisher = probe.node.create_publisher(String, "/crash", 1)
    probe.spin_until(
        lambda: publisher.get_subscription_count() > 0, 30.0, "the crasher's subscription"
    )
    publisher.publish(String(data="deep_exception"))


def send_request(probe: Probe) -> None:
    """Have it throw in a service's callback."""
    probe.start_call(Trigger, "/die", Trigger.Request(), timeout=30.0)


CALLBACKS: dict[str, tuple[float, Callable[[Probe], None] | None]] = {
    "timer": (0.0, None),
    "subscription": (-1.0, send_message),
    "service": (-1.0, send_request),
}
"""The parameter `after` of the Crasher, and what else makes it throw."""


def names_throwers(backtrace: Sequence[str]) -> bool:
    """Whether the frames begin with the functions that threw, innermost first."""
    return len(backtrace) > len(THROWERS) and all(
        re.match(rf"#{i} .*\b{name}\(", backtrace[i]) for i, name in enumerate(THROWERS)
    )
