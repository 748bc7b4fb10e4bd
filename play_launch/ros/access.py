"""The supervisor's access to the ROS graph and to managed nodes, over a hidden node of its own."""

from __future__ import annotations

import asyncio
import logging
from contextlib import asynccontextmanager
from functools import partial
from typing import TYPE_CHECKING, Final

from play_launch.config.dependency import Condition
from play_launch.ros.managed_node import ManagedNodeClient
from play_launch.ros.thread import node_pool

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterable, Mapping

    from rclpy.node import Node

    from play_launch.ros.thread import RosThread

_log = logging.getLogger(__name__)

_RETRY_INTERVAL: Final = 10.0
"""Seconds after an error until the graph is read again."""

Wanted = frozenset[tuple[Condition, str]]
"""NODE, TOPIC or SERVICE, with a full name."""


class RosAccess:
    """Has a node in the domain that the variables of the system name, only while it is needed."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._environment = environment

    def watch_graph(self, on_change: Callable[[Wanted], None]) -> GraphSource:
        """Return a source of changes of the graph, which watches nothing yet."""
        return GraphSource(self._environment, on_change)

    @asynccontextmanager
    async def managed_node(
        self, name: str, on_state: Callable[[int], None]
    ) -> AsyncIterator[ManagedNodeClient]:
        """Give a client of a managed node; ``on_state`` gets every state that it enters."""
        async with node_pool.used(self._environment) as thread:
            client = ManagedNodeClient(thread, name, on_state)
            try:
                yield client
            finally:
                client.close()


class GraphSource:
    """Reads the graph after each of its changes, while something is watched.

    Belongs to one event loop.
    """

    def __init__(self, environment: Mapping[str, str], on_change: Callable[[Wanted], None]) -> None:
        """``on_change`` gets those of the watched that exist."""
        self._environment = environment
        self._on_change = on_change
        self._wanted: Wanted = frozenset()
        self._thread: RosThread | None = None
        self._task: asyncio.Task[None] | None = None

    def watch(self, wanted: Iterable[tuple[Condition, str]]) -> None:
        """Watch these from now on, and no others."""
        self._wanted = frozenset(wanted)
        if self._thread is not None:
            self._thread.check_again()
        if self._wanted and (self._task is None or self._task.done()):
            self._task = asyncio.get_running_loop().create_task(self._run())

    async def close(self) -> None:
        """End it, and its use of the node."""
        self._wanted = frozenset()
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _run(self) -> None:
        # Something may be wanted again while the node of before is being destroyed.
        while self._wanted:
            try:
                await self._read_while_wanted()
            except Exception as error:  # noqa: BLE001 - units wait for it
                _log.error(
                    "the ROS graph cannot be read, next try in %g s: %s", _RETRY_INTERVAL, error
                )
                await asyncio.sleep(_RETRY_INTERVAL)

    async def _read_while_wanted(self) -> None:
        async with node_pool.used(self._environment) as thread:
            self._thread = thread
            try:
                while wanted := self._wanted:
                    seen = thread.graph_changes
                    self._on_change(await thread.call(partial(existing, wanted=wanted)))
                    await thread.until(partial(self._is_news, wanted, seen, thread))
            finally:
                self._thread = None

    def _is_news(self, wanted: Wanted, seen: int, thread: RosThread, _: Node) -> bool:
        return self._wanted is not wanted or thread.graph_changes != seen


def existing(node: Node, wanted: Wanted) -> Wanted:
    """Return those that are in the graph now; in the thread of the node."""
    kinds = {kind for kind, _ in wanted}
    nodes: set[str] = set()
    services: set[str] = set()
    if Condition.NODE in kinds:
        found = node.get_node_names_and_namespaces()
        nodes = {f"{namespace.rstrip('/')}/{name}" for name, namespace in found}
    if Condition.SERVICE in kinds:
        services = {name for name, _ in node.get_service_names_and_types()}
    return frozenset(
        (kind, name)
        for kind, name in wanted
        if (
            node.count_publishers(name) > 0
            if kind is Condition.TOPIC
            else name in (nodes if kind is Condition.NODE else services)
        )
    )
