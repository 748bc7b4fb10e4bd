"""Calls services of nodes from a command: a node of our own for as long as that takes; blocks."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Any, Final, Self

from play_launch.ros.fastdds.own_participant import as_our_own

if TYPE_CHECKING:
    from collections.abc import Callable

_SLICE: Final = 0.1
"""Seconds of one wait for ROS."""


class NodeServiceError(Exception):
    """A node did not answer; the text says which one."""


class NodeServices:
    """Speaks ROS in the environment of this process. It belongs to one thread."""

    def __init__(self) -> None:
        """Take part in the graph."""
        # Takes longer than all the rest of a command.
        from rclpy.context import Context  # noqa: PLC0415
        from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415
        from rclpy.node import Node  # noqa: PLC0415
        from rclpy.utilities import get_rmw_implementation_identifier  # noqa: PLC0415

        self._context = Context()
        with as_our_own(os.environ, get_rmw_implementation_identifier()):
            # No log file: a command has nothing to log, and its user may have no home.
            self._context.init(args=["--ros-args", "--disable-external-lib-logs"])
            self._node = Node(
                f"_play_launch_command_{os.getpid()}",
                context=self._context,
                use_global_arguments=False,
                enable_rosout=False,
                start_parameter_services=False,
            )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()  # type: ignore[no-untyped-call]
        self._context.try_shutdown()

    def call(self, node: str, service: str, kind: Any, request: Any, limit: float) -> Any:
        """Call ``<node>/<service>`` of that type and return the response.

        Raises:
            NodeServiceError: When there is no such service, or no answer within ``limit`` seconds.
        """
        deadline = time.monotonic() + limit
        client = self._node.create_client(kind, f"{node}/{service}")
        try:
            if not self.until(client.service_is_ready, deadline):
                raise NodeServiceError(
                    f"{node} offers no {service} in ROS domain "
                    f"{os.environ.get('ROS_DOMAIN_ID') or 0}"
                )
            answer = client.call_async(request)
            if not self.until(answer.done, deadline):
                raise NodeServiceError(f"{node} did not answer {service} within {limit:g} s")
            return answer.result()  # type: ignore[no-untyped-call]
        finally:
            self._node.destroy_client(client)

    def nodes(self) -> set[str]:
        """Full names of the nodes that are seen in the graph by now."""
        found = self._node.get_node_names_and_namespaces()
        return {f"{namespace.rstrip('/')}/{name}" for name, namespace in found}

    def services(self) -> dict[str, list[str]]:
        """Names of the services that are seen by now, with their types."""
        return dict(self._node.get_service_names_and_types())

    def until(self, is_so: Callable[[], bool], deadline: float) -> bool:
        """Spin until something is so; False when the monotonic clock comes to ``deadline``."""
        while not is_so():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            self._executor.spin_once(timeout_sec=min(left, _SLICE))
        return True
