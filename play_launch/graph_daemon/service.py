"""Answers calls: waits until the graph is known, and queries it once for each change."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import threading
import time
from typing import TYPE_CHECKING, Any, Final, NamedTuple
from xmlrpc.server import SimpleXMLRPCDispatcher

from play_launch.graph_daemon.contract import (
    ENDPOINTS_METHOD,
    GRAPH_METHODS,
    JSON_METHOD,
    LONGEST_USE,
    SHUTDOWN_METHOD,
    STATUS_METHOD,
    UNSERVED_METHOD,
)
from play_launch.graph_daemon.warm_up import Population, Pulse
from play_launch.graph_daemon.xml_rpc import dump_fault, dump_response, parse_call

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from play_launch.graph_daemon.ros_graph import RosGraph

HOLD: Final = 4.0
"""A reply that took a time is used for that many times as long, whatever changes: while sixty
processes start, the graph changes faster than an answer is written."""
LONGEST_HOLD: Final = 0.25
LONGEST_COUNT: Final = 10.0
"""Seconds that a count of the graph's population is used for; counting 54 nodes takes 5 ms."""
CACHE_LIMIT: Final = 32 * 1024 * 1024
"""Bytes of requests and replies that are kept."""
_SHUTDOWN_HELP: Final = "# function to shutdown daemon remotely"
"""The answer of ros2cli's daemon to ``system.methodHelp`` of this method."""
_log = logging.getLogger(__name__)


class _Reply(NamedTuple):
    body: bytes
    generation: int
    asked: float
    held_until: float


class GraphService:
    """The daemon without its sockets. Everything but `changed` and `use` is for the loop's thread.

    ``functions`` are the methods of the graph; ``shutdown`` is called when a client ends it.
    """

    def __init__(
        self,
        functions: Mapping[str, Callable[..., Any]],
        *,
        participants_here: Callable[[], int],
        status: Callable[..., str],
        shutdown: Callable[[], None],
    ) -> None:
        self._dispatcher = SimpleXMLRPCDispatcher(allow_none=True)
        self._dispatcher.register_introspection_functions()
        for name, function in functions.items():
            self._dispatcher.register_function(function, name)

        def on_shutdown() -> None:
            shutdown()

        on_shutdown.__doc__ = _SHUTDOWN_HELP
        self._dispatcher.register_function(on_shutdown, SHUTDOWN_METHOD)
        self._status = status
        self._participants_here = participants_here
        self._graph: RosGraph | None = None
        self.generation = 0
        """Grows with every change of the graph."""
        self._counting = threading.Lock()
        self._querying = threading.Lock()
        self.pulse = Pulse(time.monotonic())
        self._warm = asyncio.Event()
        self._counted: tuple[int, float, Population] | None = None
        self._replies: dict[bytes, _Reply] = {}
        self._size = 0
        self.last_request = time.monotonic()
        """When the last call came, on the monotonic clock."""
        self.cached_replies = 0

    @property
    def graph(self) -> RosGraph:
        if self._graph is None:
            raise RuntimeError("there is no node yet")
        return self._graph

    @property
    def is_warm(self) -> bool:
        return self._warm.is_set()

    def use(self, graph: RosGraph) -> None:
        """Query the graph through this node from now on."""
        if self._graph is None:
            self.pulse = Pulse(time.monotonic())
        with self._querying:  # afterwards no query uses the old one
            self._graph = graph
        self.changed()

    def changed(self) -> None:
        """Count a change of the graph, which invalidates the replies that are not held."""
        # While the node is replaced, two of them report.
        with self._counting:
            self.generation += 1
            self.pulse.change(time.monotonic())

    def check_warm(self) -> bool:
        """Release the requests about the graph when it is known well enough."""
        if self.is_settled(self.graph) or self.pulse.is_overdue(time.monotonic()):
            self._warm.set()
        return self.is_warm

    def is_settled(self, graph: RosGraph) -> bool:
        """Whether nothing changes, and this node knows all participants that should be there."""
        # Whatever rclpy raises, a limit ends the wait for it.
        with contextlib.suppress(Exception):
            return self.pulse.is_quiet(time.monotonic()) and self._population_of(graph).is_complete
        return False

    def population(self) -> Population:
        """Return the numbers of nodes; counted anew after a change, or after `LONGEST_COUNT`."""
        now, generation = time.monotonic(), self.generation
        known = self._counted
        if known is None or known[0] != generation or now - known[1] > LONGEST_COUNT:
            self._counted = known = generation, now, self._population_of(self.graph)
        return known[2]._replace(participants_here=self._participants_here())

    def doubtful(self) -> frozenset[tuple[str, str]]:
        """Give the nodes of the graph that may not exist any more."""
        with self._querying:
            return self.graph.doubtful()

    async def answer(self, body: bytes) -> bytes:
        """Answer a request: at once, or, if it is about the graph, when that is warm."""
        self.last_request = time.monotonic()
        if reply := self._cached(body):
            return reply
        try:
            method, arguments = parse_call(body)
        except Exception as error:  # noqa: BLE001 - foreign bytes raise many kinds
            return dump_fault(error)
        if method not in GRAPH_METHODS and method != JSON_METHOD:
            return self._call(method, arguments)
        if not self.is_warm:
            await self._warm.wait()
            return await self.answer(body)  # others may have had the same request
        with self._querying:
            # From before the query: what changes meanwhile may not be in the reply.
            generation, asked = self.generation, time.monotonic()
            reply = self._call(method, arguments)
            self._keep(body, reply, generation, asked)
            return reply

    def close(self) -> None:
        self._warm.set()

    def _call(self, method: str | None, arguments: tuple[Any, ...]) -> bytes:
        try:
            if method == STATUS_METHOD:
                return dump_response(self._status(*arguments))
            if method == JSON_METHOD:
                if arguments == (ENDPOINTS_METHOD,):
                    return dump_response(json.dumps(self.graph.endpoints()))
                if arguments == (UNSERVED_METHOD,):
                    return dump_response(json.dumps(self.graph.unserved_services()))
                if not arguments or arguments[0] not in GRAPH_METHODS:
                    raise ValueError("no method of the graph")  # noqa: TRY301 - becomes a fault
                found = self._dispatcher._dispatch(arguments[0], arguments[1:])  # noqa: SLF001
                return dump_response(json.dumps(found, default=str))
            # It is meant to be called: its documentation describes how to override it.
            return dump_response(self._dispatcher._dispatch(method, arguments))  # type: ignore[arg-type]  # noqa: SLF001
        except Exception as error:  # noqa: BLE001 - whatever it is, it is reported to the client
            return dump_fault(error)

    def _cached(self, request: bytes) -> bytes | None:
        reply = self._replies.get(request)
        now = time.monotonic()
        if reply is None or now - reply.asked > LONGEST_USE:
            return None
        if reply.generation != self.generation and now >= reply.held_until:
            return None
        self.cached_replies += 1
        return reply.body

    def _keep(self, request: bytes, body: bytes, generation: int, asked: float) -> None:
        now = time.monotonic()
        old = self._replies.pop(request, None)
        size = len(request) + len(body)
        self._size += size - (len(request) + len(old.body) if old else 0)
        if self._size > CACHE_LIMIT:
            self._replies.clear()
            self._size = size
        hold = min(HOLD * (now - asked), LONGEST_HOLD)
        self._replies[request] = _Reply(body, generation, asked, now + hold)

    def _population_of(self, graph: RosGraph) -> Population:
        with self._querying:
            participants, nameless = graph.met()
            nodes = sum(name != graph.name for name, _ in graph.nodes())
        return Population(nodes, participants, self._participants_here(), nameless)
