"""A plain rclpy node for tests: it knows nothing of play-launch."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

import rclpy
from composition_interfaces.srv import ListNodes, LoadNode, UnloadNode
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from play_launch.ros.fastdds.own_participant import end_participants_safely

LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def begin(arguments: list[str] | None = None) -> Context:
    """A context whose participants come to an end; `rclpy.init()` alone may hang a test process."""
    context = Context()
    rclpy.init(args=arguments, context=context)
    end_participants_safely()
    return context


class Probe:
    """An rclpy node in a context of its own; every wait is bounded and ends on the event."""

    def __init__(self, name: str = "probe") -> None:
        self._context = begin()
        # Sessions of the same domain would ask for its parameters.
        self.node = Node(name, context=self._context, start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def spin_until(self, done: Callable[[], bool], timeout: float, what: str) -> None:
        """Handle events until ``done``; AssertionError naming ``what`` after ``timeout`` s."""
        deadline = time.monotonic() + timeout
        while not done():
            left = deadline - time.monotonic()
            assert left > 0, f"waited {timeout} s for {what}"
            # The graph has no event in rclpy, so it is looked at twenty times a second.
            self._executor.spin_once(timeout_sec=min(left, 0.05))

    def call(self, service: Any, name: str, request: Any, timeout: float = 60.0) -> Any:
        """Call a service and return its response."""
        client = self.node.create_client(service, name)
        try:
            self.spin_until(client.service_is_ready, timeout, f"service {name}")
            future = client.call_async(request)
            self.spin_until(future.done, timeout, f"the answer of {name}")
            return future.result()
        finally:
            self.node.destroy_client(client)

    def load(
        self,
        plugin: str,
        *,
        package: str = "play_launch_demo",
        container: str = "/container",
        **fields: Any,
    ) -> Any:
        """Load a component by the container's service; the response."""
        plugin = plugin if "::" in plugin else f"{package}::{plugin}"
        request = LoadNode.Request(package_name=package, plugin_name=plugin, **fields)
        return self.call(LoadNode, f"{container}/_container/load_node", request)

    def unload(self, unique_id: int, container: str = "/container") -> Any:
        """Unload a node by the container's service; the response."""
        request = UnloadNode.Request(unique_id=unique_id)
        return self.call(UnloadNode, f"{container}/_container/unload_node", request)

    def nodes(self, container: str = "/container") -> list[tuple[str, int]]:
        """Full names and ids of the nodes of a container, by its service."""
        answer = self.call(ListNodes, f"{container}/_container/list_nodes", ListNodes.Request())
        return list(zip(answer.full_node_names, answer.unique_ids, strict=True))

    def start_call(self, service: Any, name: str, request: Any, timeout: float = 60.0) -> Any:
        """Send a request and return its future; the client lives as long as the probe."""
        client = self.node.create_client(service, name)
        self.spin_until(client.service_is_ready, timeout, f"service {name}")
        return client.call_async(request)

    def collect(
        self, message: Any, topic: str, count: int = 1, timeout: float = 60.0, qos: Any = 10
    ) -> list[Any]:
        """Return ``count`` messages of a topic."""
        heard: list[Any] = []
        subscription = self.node.create_subscription(message, topic, heard.append, qos)
        try:
            self.spin_until(lambda: len(heard) >= count, timeout, f"{count} messages on {topic}")
        finally:
            self.node.destroy_subscription(subscription)
        return heard

    def listen(self, message: Any, topic: str, qos: Any = 10) -> list[Any]:
        """Return a list that fills with the messages of a topic while this probe spins."""
        heard: list[Any] = []
        self.node.create_subscription(message, topic, heard.append, qos)
        return heard
