"""What the supervisor asks of ROS for those that wait: the graph, and managed nodes."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from play_launch.ros.graph_source import GraphSource
from play_launch.ros.managed_node import ManagedNodeClient, managed_node
from play_launch.ros.shared_thread import SharedRosThread, thread_in

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from contextlib import AbstractAsyncContextManager

    from play_launch.ros.graph_source import Wanted


class RosAccess:
    """Takes part in ROS, with one hidden node, only while it is needed."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        """Be in the domain that the variables of the system name."""
        self._ros = SharedRosThread(partial(thread_in, environment))

    def watch_graph(self, on_change: Callable[[Wanted], None]) -> GraphSource:
        """Give a view of the graph; it watches nothing yet."""
        return GraphSource(self._ros, on_change)

    def managed_node(
        self, name: str, on_state: Callable[[int], None]
    ) -> AbstractAsyncContextManager[ManagedNodeClient]:
        """Give a client of a managed node; ``on_state`` gets every state that it enters."""
        return managed_node(self._ros, name, on_state)
