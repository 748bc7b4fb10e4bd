"""Publishers and subscriptions of the ROS graph."""

from __future__ import annotations

from typing import Final

from msgspec import Struct

UNCHECKED: Final = frozenset({"/rosout", "/parameter_events"})
"""Topics that every node has."""


class Endpoint(Struct, frozen=True, order=True):
    """A publisher with what it offers, or a subscription with what it requests.

    The fields are those of ``play_launch_msgs/GraphEndpoint``.
    """

    topic: str
    node: str
    """Full name."""
    type: str
    """``package/msg/Name``."""
    is_publisher: bool
    reliability: int = 0
    durability: int = 0
    liveliness: int = 0
    deadline: int = 0
    """Nanoseconds, as the next one; 0: no limit."""
    lease_duration: int = 0

    @property
    def is_hidden(self) -> bool:
        """Whether its node is one of a tool, such as ``ros2 topic echo``."""
        return self.node.rpartition("/")[2].startswith("_")
