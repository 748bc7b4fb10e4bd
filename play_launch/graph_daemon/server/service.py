"""Answers requests about the graph: waits until it is known, and asks it once per change."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from typing import TYPE_CHECKING, Any, Final, Protocol

from play_launch.graph_daemon.server.methods import Call, Methods, parse
from play_launch.graph_daemon.server.reply_cache import ReplyCache
from play_launch.graph_daemon.server.warm_up import Population, Pulse

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

LONGEST_COUNT: Final = 10.0
"""Seconds that a count of the graph's population is used for.

A replay asks again and again, and counting 54 nodes takes 5 ms. With a middleware that does not
report its changes the count is wrong for as long.
"""
_log = logging.getLogger(__name__)


class Graph(Protocol):
    """What is asked of a node that looks at the graph; see `ros_graph.RosGraph`."""

    @property
    def name(self) -> str:
        """The node's name."""
        ...

    def nodes(self) -> list[tuple[str, str]]:
        """Name and namespace of every node."""
        ...

    def met(self) -> tuple[int, int]:
        """How many participants are known, and how many publishers without their node."""
        ...

    def call(self, method: str, *arguments: object) -> Any:
        """Call a method of the graph."""
        ...

    def close(self) -> None:
        """Leave the graph."""
        ...


class GraphService:
    """The daemon without its sockets.

    Everything but `changed` is for the loop's thread.

    Args:
        functions: The methods of the graph, by name.
        participants_here: Counts the participants of this machine.
        status: Gives the answer of our own method.
        shutdown: Called when a client asks the daemon to end.
        cache: Keeps the answers.
    """

    def __init__(
        self,
        functions: Mapping[str, Callable[..., Any]],
        *,
        participants_here: Callable[[], int],
        status: Callable[..., str],
        shutdown: Callable[[], None],
        cache: ReplyCache | None = None,
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._methods = Methods(functions, status=status, shutdown=shutdown)
        self._participants_here = participants_here
        self._cache = cache or ReplyCache()
        self._generation = 0
        self._counting = threading.Lock()
        self._graph: Graph | None = None
        self._pulse = Pulse(time.monotonic())
        self._warm = asyncio.Event()
        self._timer: asyncio.TimerHandle | None = None
        self._look_failed = False
        self._counted: tuple[int, float, Population] | None = None
        self.last_request = time.monotonic()
        """When the last call came, on the monotonic clock."""
        self.cached_replies = 0

    @property
    def graph(self) -> Graph:
        """The node in use."""
        if self._graph is None:
            raise RuntimeError("there is no node yet")
        return self._graph

    @property
    def generation(self) -> int:
        """Grows with every change of the graph."""
        return self._generation

    @property
    def pulse(self) -> Pulse:
        """How restless the graph is."""
        return self._pulse

    @property
    def is_warm(self) -> bool:
        """Whether requests are answered."""
        return self._warm.is_set()

    def use(self, graph: Graph) -> None:
        """Look at the graph through this node from now on."""
        first = self._graph is None
        self._graph = graph
        self._count()
        if first:
            self._pulse = Pulse(time.monotonic())
            self._look()

    def changed(self) -> None:
        """Take note that the graph changed; for any thread.

        What was answered before counts no more from this very moment, not when the loop hears of
        it; but for the short time that answers are held which took long, see `reply_cache`.
        """
        self._count()
        # The loop may have ended before the thread that reports.
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._pulse.change, time.monotonic())

    async def wait_warm(self) -> None:
        """Wait until requests are answered."""
        await self._warm.wait()

    def population(self) -> Population:
        """Return who is in the graph; counted anew after a change, or after `LONGEST_COUNT`."""
        now, generation = time.monotonic(), self._generation
        known = self._counted
        if known is None or known[0] != generation or now - known[1] > LONGEST_COUNT:
            self._counted = known = generation, now, self._count_population()
        return known[2]._replace(participants_here=self._participants_here())

    async def answer(self, body: bytes) -> bytes:
        """Answer a request: at once, or, if it is about the graph, when that is warm."""
        self.last_request = time.monotonic()
        known = self._cache.get(body, self._generation, self.last_request)
        if known is not None:
            self.cached_replies += 1
            return known
        call = parse(body)
        if not isinstance(call, Call):
            return call
        if not call.is_about_the_graph:
            return self._methods.answer(call)
        if not self.is_warm:
            await self._warm.wait()
            # Others may have asked the same.
            return await self.answer(body)
        # Before the graph is looked at: what changes meanwhile may not be in the reply.
        generation, asked = self._generation, time.monotonic()
        reply = self._methods.answer(call)
        self._cache.put(body, reply, generation, asked, time.monotonic())
        return reply

    def close(self) -> None:
        """Wait for nothing any more."""
        if self._timer is not None:
            self._timer.cancel()
        self._warm.set()

    def _count_population(self) -> Population:
        own = self.graph.name
        participants, nameless = self.graph.met()
        nodes = sum(name != own for name, _ in self.graph.nodes())
        return Population(nodes, participants, self._participants_here(), nameless)

    def _count(self) -> None:
        # While the node is replaced, two of them report.
        with self._counting:
            self._generation += 1

    def _look(self) -> None:
        """Open the gate when it is time."""
        now = time.monotonic()
        complete = self._pulse.is_quiet(now) and self._is_complete()
        if self._pulse.is_warm(now, complete=complete):
            self._warm.set()
            return
        delay = self._pulse.look_again_at(now) - now
        self._timer = self._loop.call_later(delay, self._look)

    def _is_complete(self) -> bool:
        try:
            return self._count_population().is_complete
        except Exception:  # noqa: BLE001 - whatever rclpy raises, the gate opens at its deadline
            if not self._look_failed:
                _log.exception("who is missing in the graph cannot be determined")
            self._look_failed = True
            return False
