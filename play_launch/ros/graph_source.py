"""Changes of the awaited parts of the ROS graph."""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from typing import TYPE_CHECKING, Final

from play_launch.config.dependency import Condition

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rclpy.node import Node

    from play_launch.ros.shared_thread import SharedRosThread

_log = logging.getLogger(__name__)

_RETRY_INTERVAL: Final = 10.0
"""Seconds after an error until the graph is read again."""

Wanted = frozenset[tuple[Condition, str]]
"""NODE, TOPIC or SERVICE, with a full name."""


class GraphSource:
    """Looks at the graph after each of its changes, through a node of our own.

    Belongs to one event loop. The node is there, and rclpy imported in its thread, only as long as
    something is watched.
    """

    def __init__(self, ros: SharedRosThread, on_change: Callable[[Wanted], None]) -> None:
        """Take our way into ROS; ``on_change`` gets what of the watched is there."""
        self._ros = ros
        self._on_change = on_change
        self._wanted: Wanted = frozenset()
        self._changed = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    def watch(self, wanted: Iterable[tuple[Condition, str]]) -> None:
        """Watch these from now on, and no others."""
        self._wanted = frozenset(wanted)
        self._changed.set()
        if self._wanted and (self._task is None or self._task.done()):
            self._task = asyncio.get_running_loop().create_task(self._run())

    async def close(self) -> None:
        """End it, with its thread."""
        self._wanted = frozenset()
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _run(self) -> None:
        # Something may be wanted again while the node of before is being taken down.
        while self._wanted:
            try:
                await self._look_while_wanted()
            except Exception as error:  # noqa: BLE001 - units wait for it
                _log.error(
                    "the ROS graph cannot be read, next try in %g s: %s", _RETRY_INTERVAL, error
                )
                await asyncio.sleep(_RETRY_INTERVAL)

    async def _look_while_wanted(self) -> None:
        async with self._ros.used() as thread:
            forget = thread.listen(self._changed.set)
            try:
                while self._wanted:
                    self._changed.clear()
                    self._on_change(await thread.call(partial(look, wanted=self._wanted)))
                    await self._changed.wait()
            finally:
                forget()


def look(node: Node, wanted: Wanted) -> Wanted:
    """Find out what of this is in the graph now; in the thread of the node."""
    kinds = {kind for kind, _ in wanted}
    nodes: set[str] = set()
    services: set[str] = set()
    if Condition.NODE in kinds:
        found = node.get_node_names_and_namespaces()
        nodes = {f"{namespace.rstrip('/')}/{name}" for name, namespace in found}
    if Condition.SERVICE in kinds:
        services = {name for name, _ in node.get_service_names_and_types()}
    there = set()
    for kind, name in wanted:
        if kind is Condition.TOPIC:
            is_there = node.count_publishers(name) > 0
        else:
            is_there = name in (nodes if kind is Condition.NODE else services)
        if is_there:
            there.add((kind, name))
    return frozenset(there)
