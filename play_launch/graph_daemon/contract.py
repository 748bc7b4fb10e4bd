"""Address, methods and settings shared by the daemon, its clients and its starter.

The address, the port's rule and the path are those of ros2cli (``ros2cli/daemon``), so that its
clients find this daemon without any setting.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from play_launch import UserError
from play_launch.config.values import LARGEST_DOMAIN

if TYPE_CHECKING:
    from collections.abc import Mapping

DOMAIN_VARIABLE: Final = "ROS_DOMAIN_ID"
HOST: Final = "127.0.0.1"
BASE_PORT: Final = 11511
PATH: Final = "/ros2cli/"
NODE_PREFIX: Final = "_ros2cli_daemon_"
"""How the nodes of daemons begin, ros2cli's and ours; the underscore hides them from lists."""

IDLE_TIMEOUT: Final = 2 * 60 * 60.0
"""Seconds without a request after which the daemon ends; ros2cli's value."""
LISTENING: Final = "listening"
"""The word by which the daemon reports that it accepts clients."""
WARM: Final = "warm"
"""The word by which it reports that questions about the graph are answered."""
BACKLOG: Final = 1024
"""Clients that may wait to be accepted; the kernel may allow fewer (net.core.somaxconn)."""

LONGEST_USE: Final = 1.0
"""Seconds for which an answer is repeated at most; the graph may have changed meanwhile, even
without a report of the middleware."""
STATUS_METHOD: Final = "system.play_launch_status"
"""Answers with a JSON text, see docs/daemon.md.

The text is empty when an argument is given that is the present generation.

ros2cli's clients ignore names with ``system.``.
"""
JSON_METHOD: Final = "system.play_launch_json"
"""Calls the method that its first argument names, and answers with the result as a JSON text."""
ENDPOINTS_METHOD: Final = "endpoints"
"""For `JSON_METHOD` alone: the fields of `play_launch.supervisor.endpoints.Endpoint`, in their
order, of each publisher and subscription of the graph. Older daemons do not have it."""
UNSERVED_METHOD: Final = "unserved_services"
"""As `ENDPOINTS_METHOD`: name and types of each service that has clients and no server."""
SHUTDOWN_METHOD: Final = "system.shutdown"
GRAPH_METHODS: Final = (
    "get_name",
    "get_namespace",
    "get_node_names_and_namespaces",
    "get_node_names_and_namespaces_with_enclaves",
    "get_topic_names_and_types",
    "get_service_names_and_types",
    "get_action_names_and_types",
    "get_publisher_names_and_types_by_node",
    "get_publishers_info_by_topic",
    "get_subscriber_names_and_types_by_node",
    "get_subscriptions_info_by_topic",
    "get_service_names_and_types_by_node",
    "get_client_names_and_types_by_node",
    "get_action_server_names_and_types_by_node",
    "get_action_client_names_and_types_by_node",
    "count_publishers",
    "count_subscribers",
    "count_clients",
    "count_services",
)
"""The methods of Jazzy; with Humble's rclpy the last two do not exist."""


class DomainError(UserError):
    """``ROS_DOMAIN_ID`` is no number of a ROS domain; the message says which are."""

    def __init__(self, value: str) -> None:
        shown = value if len(value) <= 40 else f"{value[:40]}…"
        super().__init__(
            f"{DOMAIN_VARIABLE} is a number from 0 to {LARGEST_DOMAIN}, given {shown!r}; "
            "set another one"
        )


@dataclass(frozen=True, slots=True)
class DaemonAddress:
    """The address of the daemon of one domain."""

    domain: int

    def __post_init__(self) -> None:
        if not 0 <= self.domain <= LARGEST_DOMAIN:
            raise DomainError(str(self.domain))

    @property
    def host(self) -> str:
        return HOST

    @property
    def port(self) -> int:
        return BASE_PORT + self.domain

    @property
    def path(self) -> str:
        return PATH

    @property
    def url(self) -> str:
        return f"http://{self.host}:{self.port}{self.path}"


def daemon_address(environment: Mapping[str, str] = os.environ) -> DaemonAddress:
    """Return where the daemon of ``environment``'s domain listens; 0 when none is set, as in rcl.

    Raises ``DomainError`` for anything but a decimal number from 0 to 232.
    """
    text = environment.get(DOMAIN_VARIABLE, "") or "0"
    if not (text.isascii() and text.isdecimal()) or len(text) > len(str(LARGEST_DOMAIN)):
        raise DomainError(text)
    return DaemonAddress(int(text))
