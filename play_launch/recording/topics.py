"""The topics of a session recording.

They live in a namespace of their own, so that playing a recording back cannot disturb a running
system: nothing subscribes to ``/play_launch`` but people who look at recordings.
"""

from __future__ import annotations

from typing import Final

from msgspec import Struct

_INFINITE: Final = "{sec: 9223372036, nsec: 854775807}"
_KEEP_LAST: Final = 1
_RELIABLE: Final = 1
_TRANSIENT_LOCAL: Final = 1
_VOLATILE: Final = 2
_LIVELINESS_AUTOMATIC: Final = 1


class Topic(Struct, frozen=True):
    """A recorded topic: its name, its message type and what a publisher would offer."""

    name: str
    type_name: str
    """``package/msg/Name``."""
    depth: int = 1000
    latched: bool = False
    """True for durability ``transient_local``."""

    @property
    def offered_qos_profiles(self) -> str:
        """The quality of service as YAML, as rosbag2 stores it beside a channel.

        The policies are written as numbers: every rosbag2 from Foxy on reads those, while the
        words are understood from Jazzy on only.
        """
        return (
            f"- history: {_KEEP_LAST}\n"
            f"  depth: {self.depth}\n"
            f"  reliability: {_RELIABLE}\n"
            f"  durability: {_TRANSIENT_LOCAL if self.latched else _VOLATILE}\n"
            f"  deadline: {_INFINITE}\n"
            f"  lifespan: {_INFINITE}\n"
            f"  liveliness: {_LIVELINESS_AUTOMATIC}\n"
            f"  liveliness_lease_duration: {_INFINITE}\n"
            "  avoid_ros_namespace_conventions: false"
        )


COMPONENT_EVENTS: Final = Topic(
    "/play_launch/events", "play_launch_msgs/msg/ComponentEvent", depth=100, latched=True
)
STATES: Final = Topic("/play_launch/states", "play_launch_msgs/msg/StateEvent", latched=True)
GRAPH: Final = Topic("/play_launch/graph", "play_launch_msgs/msg/GraphEvent")
OUTPUT: Final = Topic("/play_launch/output", "rcl_interfaces/msg/Log")
LOG: Final = Topic("/play_launch/log", "rcl_interfaces/msg/Log")
LOG_ALL: Final = Topic("/play_launch/log/all", "rcl_interfaces/msg/Log")

ALL_TOPICS: Final = (COMPONENT_EVENTS, STATES, GRAPH, OUTPUT, LOG, LOG_ALL)
