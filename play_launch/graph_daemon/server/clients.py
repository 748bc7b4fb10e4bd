"""Serves any number of clients from one thread, within bounds."""

from __future__ import annotations

import asyncio
import contextlib
import resource
from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from play_launch.graph_daemon.contract import BACKLOG
from play_launch.graph_daemon.server.connection import Connection

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable

_READ_AT_ONCE: Final = 16 * 1024
_SPARE_FILES: Final = 64
"""Descriptors that the rest of the process needs."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What clients may take."""

    deadline: float = 10.0
    """Seconds for a request, or for taking its answer; an idle connection is kept as long."""
    connections: int = 1000
    """Where one more comes, the one that has made no progress for longest is reset."""
    memory: int = 64 * 1024 * 1024
    """Bytes of requests and answers that are held for all clients; beyond it, the same."""
    farewell: float = 1.0
    """Seconds that clients are given to take their answers and close when the daemon ends."""


class Server:
    """Accepts clients on a listening socket and passes their requests on.

    Args:
        listener: Bound and listening; it belongs to the server from now on.
        answer: Called with the body of a request and a function that takes the body of the
            response, to be called once, in the loop's thread, then or later.
        limits: What clients may take.
    """

    def __init__(
        self,
        listener: socket.socket,
        answer: Callable[[bytes, Callable[[bytes], None]], None],
        limits: Limits | None = None,
    ) -> None:
        self.read_buffer = bytearray(_READ_AT_ONCE)
        self.requests = 0
        """How many requests were answered."""
        self.resets = 0
        """How many connections were reset for their deadline, or because there were too many."""
        self._answer = answer
        self._listener = listener
        self._limits = limits or Limits()
        self._most = min(self._limits.connections, _files_allowed(self._limits.connections))
        self._connections: OrderedDict[Connection, None] = OrderedDict()
        self._held = 0
        self._closing = False
        self._timer: asyncio.TimerHandle | None = None
        self._accepting: asyncio.Server | None = None
        self._adopting: set[asyncio.Task[None]] = set()
        self._empty = asyncio.Event()
        self._empty.set()

    @property
    def is_closing(self) -> bool:
        """Whether `close` was called."""
        return self._closing

    @property
    def connections(self) -> int:
        """How many clients there are."""
        return len(self._connections)

    @property
    def held(self) -> int:
        """Bytes of requests and answers that are held for all clients."""
        return self._held

    async def start(self) -> None:
        """Accept clients from now on."""
        self._loop = asyncio.get_running_loop()
        self._listener.setblocking(False)
        self._accepting = await self._loop.create_server(
            lambda: Connection(self), sock=self._listener, backlog=BACKLOG
        )

    def stop_listening(self) -> None:
        """Accept those that have come, and nobody else; the port refuses connections then."""
        self._closing = True
        if self._accepting is None:
            return
        waiting = []
        with contextlib.suppress(OSError):
            while True:
                waiting.append(self._listener.accept()[0])
        self._accepting.close()
        self._accepting = None
        for client in waiting:
            task = self._loop.create_task(self._adopt(client))
            self._adopting.add(task)
            task.add_done_callback(self._adopting.discard)

    async def _adopt(self, client: socket.socket) -> None:
        with contextlib.suppress(OSError):
            await self._loop.connect_accepted_socket(lambda: Connection(self), client)

    async def close(self) -> None:
        """Stop listening, give answers that are under way, and reset who is left."""
        self.stop_listening()
        await asyncio.gather(*self._adopting)
        for connection in list(self._connections):
            if connection.is_idle:
                connection.abort()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._empty.wait(), self._limits.farewell)
        for connection in list(self._connections):
            connection.abort()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._empty.wait(), self._limits.farewell)
        if self._timer is not None:
            self._timer.cancel()

    # What connections call.

    def opened(self, connection: Connection) -> None:
        """Take a new client; where there are too many, reset the oldest."""
        self._empty.clear()
        if len(self._connections) >= self._most:
            self._reset_oldest()
        self._connections[connection] = None
        connection.deadline = self._loop.time() + self._limits.deadline
        self._watch()

    def progressed(self, connection: Connection) -> None:
        """Begin the deadline anew."""
        self.requests += 1
        if connection in self._connections:
            connection.deadline = self._loop.time() + self._limits.deadline
            self._connections.move_to_end(connection)

    def resized(self, connection: Connection) -> None:
        """Count what is held; reset the oldest clients while that is too much."""
        self._account(connection, connection.held)
        while self._held > self._limits.memory and self._connections:
            # A client that holds nothing would free nothing.
            oldest = next((other for other in self._connections if other.accounted), None)
            if oldest is None:
                return
            self._reset(oldest)

    def closed(self, connection: Connection) -> None:
        """Forget a client."""
        self._forget(connection)

    def answer(self, body: bytes, reply: Callable[[bytes], None]) -> None:
        """Pass a request on."""
        self._answer(body, reply)

    def _account(self, connection: Connection, held: int) -> None:
        if connection in self._connections:
            self._held += held - connection.accounted
            connection.accounted = held

    def _reset_oldest(self) -> None:
        self._reset(next(iter(self._connections)))

    def _reset(self, connection: Connection) -> None:
        self.resets += 1
        self._forget(connection)
        connection.abort()

    def _forget(self, connection: Connection) -> None:
        if connection in self._connections:
            self._account(connection, 0)
            del self._connections[connection]
        if not self._connections:
            self._empty.set()

    def _watch(self) -> None:
        """Look after deadlines; they are in the order of the connections."""
        if self._timer is None and self._connections:
            first = next(iter(self._connections))
            self._timer = self._loop.call_at(first.deadline, self._on_deadline)

    def _on_deadline(self) -> None:
        self._timer = None
        now = self._loop.time()
        for connection in list(self._connections):
            if connection.deadline > now:
                break
            self._reset(connection)
        self._watch()


def _files_allowed(wanted: int) -> int:
    """Raise the limit of open files as far as it is needed and may be; return what it allows."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = wanted + _SPARE_FILES
    if soft != resource.RLIM_INFINITY and soft < needed:
        raised = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, raised), hard))
            soft = max(soft, raised)
    return wanted if soft == resource.RLIM_INFINITY else max(1, soft - _SPARE_FILES)
