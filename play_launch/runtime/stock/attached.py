"""A container that somebody else has started: nothing of its process is ours to end."""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from play_launch.process.exit import Exit
from play_launch.runtime.sources import first_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.ros.composition import ListedNode
    from play_launch.runtime.stock.link import StockLink
    from play_launch.runtime.stock.ports import CompositionServices, StockLimits

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, repr=False)
class Parting(Exit):
    """The end of an attachment; how the process ended, if it did, is not known."""

    reason: str = ""

    def __str__(self) -> str:
        return self.reason


class AttachedContainer:
    """What takes the place of a process of our own: it ends when the container is gone, or let go.

    A container is gone when its services leave the graph, or when others under the same name have
    taken their place. A participant that was killed leaves the graph when its lease is over (20 s
    unless configured otherwise); one that ended in order leaves at once.
    """

    def __init__(
        self,
        name: str,
        link: StockLink,
        services: CompositionServices,
        *,
        ask: float,
        limits: StockLimits,
    ) -> None:
        """Watch; ``ask`` is how many seconds unloading may take at the end."""
        self._name = name
        self._link = link
        self._services = services
        self._ask = ask
        self._limits = limits
        self._exit: Parting | None = None
        self._ended = asyncio.Event()
        self._servers: frozenset[bytes] = frozenset()
        self._has_newcomers = False
        self._graph_changed = asyncio.Event()
        services.on_graph_change(self._graph_changed.set)
        link.on_list = self._on_list
        self._watching = asyncio.get_running_loop().create_task(self._watch())
        self._watching.add_done_callback(self._watching_ended)

    @property
    def pid(self) -> int:
        """Not known."""
        return 0

    @property
    def start_time(self) -> int:
        """Not known."""
        return 0

    @property
    def argv(self) -> tuple[str, ...]:
        """Not ours."""
        return ()

    async def wait(self) -> Exit:
        """Wait until it is gone or let go."""
        await self._ended.wait()
        assert self._exit is not None
        return self._exit

    async def gone(self) -> Exit:
        """The same: nothing of it is left with us."""
        return await self.wait()

    def kill(self) -> None:
        """Let it go; it is not killed."""
        self._end("let go")

    async def stop(self, *, ask: Callable[[], bool] | None, hurry: asyncio.Event) -> bool:
        """Unload what was loaded by us, and let it go."""
        del ask
        with suppress(TimeoutError):
            async with asyncio.timeout(self._ask):
                await first_of(self._link.unload_all(), hurry.wait(), self._ended.wait())
        left = self._link.composition.unfinished()
        if left and self._exit is None:
            names = ", ".join(each.full_name or each.wanted.label for each in left)
            _log.warning("%s keeps %s: not unloaded in time", self._name, names)
        self._end("let go")
        return True

    def _end(self, reason: str) -> None:
        if self._exit is not None:
            return
        self._exit = Parting(reason=reason)
        self._watching.cancel()
        self._link.end(reason, in_order=False)
        self._ended.set()

    def _watching_ended(self, task: asyncio.Task[None]) -> None:
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("%s cannot be watched: %s", self._name, error, exc_info=error)
            self._end(f"it cannot be watched: {error}")

    async def _watch(self) -> None:
        try:
            async with asyncio.timeout(self._limits.waiting):
                await self._services.ready()
        except TimeoutError:
            _log.warning("waiting for %s: no container of that name is running", self._name)
            await self._services.ready()
        while True:
            self._graph_changed.clear()
            await self._look_at_servers()
            await self._graph_changed.wait()

    async def _look_at_servers(self) -> None:
        servers = await self._services.servers()
        if not self._link.is_greeted or (servers and not self._servers):
            self._servers = servers
        elif not await self._services.is_ready():
            self._end("it is gone: its services are not in the graph any more")
        elif servers and self._servers and not servers & self._servers:
            self._end("another container has taken its name")
        elif servers - self._servers:
            # Started anew while the dead one is still in the graph, or a second one beside it.
            self._has_newcomers = True
            self._link.look()

    def _on_list(self, nodes: tuple[ListedNode, ...]) -> None:
        ours = self._link.composition.loaded()
        if not self._has_newcomers or not ours:
            return
        listed = dict(nodes)
        if not any(listed.get(each.unique_id) == each.full_name for each in ours):
            self._end("it was started anew: it has none of the nodes that it had")
