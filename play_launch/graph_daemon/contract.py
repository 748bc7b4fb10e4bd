"""What the daemon, its clients and its starter agree upon."""

from __future__ import annotations

from typing import Final

IDLE_TIMEOUT: Final = 2 * 60 * 60.0
"""Seconds without a request after which the daemon ends; ros2cli's value."""
LISTENING: Final = "listening"
"""The word by which the daemon reports that it accepts clients."""
WARM: Final = "warm"
"""The word by which it reports that questions about the graph are answered."""
BACKLOG: Final = 1024
"""Clients that may wait to be accepted; the kernel may allow fewer (net.core.somaxconn)."""

STATUS_METHOD: Final = "system.play_launch_status"
"""Answers with a JSON text, see `status`. ros2cli's clients ignore names with ``system.``."""
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
