"""Serves any number of clients from one thread, within bounds; lets each close first.

A thread a connection, as the standard library's server has it, answers a storm of starting nodes
five times later (docs/decisions/graph-daemon.md).

The side that closes a TCP connection first keeps its port busy for a minute (TIME_WAIT), and
ros2cli's daemon cannot start while our port is busy. So a connection is closed after the client's
end of it, or else by a reset: at its deadline, or when it takes too much. Until the client's end
has come the socket is set to be reset on closing, so that even a killed daemon leaves nothing
behind.

Connections read from their sockets in sequence, without asyncio's streams: those read up to 256 KiB
of each client ahead, here it is 16 KiB, and what is not read yet waits in the kernel.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import resource
import socket
import struct
from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from play_launch.graph_daemon.contract import BACKLOG
from play_launch.graph_daemon.http_head import (
    END_OF_HEAD,
    LONGEST_HEAD,
    Rejection,
    parse_head,
    response,
)

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable


_READ_AT_ONCE: Final = 16 * 1024
_RESET_ON_CLOSE: Final = struct.pack("ii", 1, 0)
_CLOSE_IN_ORDER: Final = struct.pack("ii", 0, 0)
_ACCEPTED_AT_ONCE: Final = 64
_PAUSE: Final = 1.0
"""Seconds until clients are accepted again where no descriptor or memory was left for one."""
_SPARE_FILES: Final = 64
"""Descriptors that the rest of the process needs."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ServerLimits:
    """What clients may take."""

    deadline: float = 10.0
    """Seconds for a request, or for taking its answer; an idle connection is kept as long."""
    connections: int = 1000
    """Where one more comes, the one that has made no progress for longest is reset."""
    memory: int = 64 * 1024 * 1024
    """Bytes of requests and answers that are held for all clients; beyond it, the same."""
    farewell: float = 1.0
    """Seconds that clients are given to take their answers and close when the daemon ends."""


class HttpServer:
    """Accepts clients on a listening socket and passes their requests on.

    The listener belongs to the server; ``answer`` is called with the body of a request and returns
    that of the response.
    """

    def __init__(
        self,
        listener: socket.socket,
        answer: Callable[[bytes], Awaitable[bytes]],
        limits: ServerLimits | None = None,
    ) -> None:
        self.answer = answer
        self.requests = 0
        """How many requests were answered."""
        self.resets = 0
        """How many connections were reset for their deadline, or because there were too many."""
        self.held = 0
        """Bytes of requests and answers that are held for all clients."""
        self.is_closing = False
        """Whether it stopped listening."""
        self._listener = listener
        self._limits = limits or ServerLimits()
        self._most = min(self._limits.connections, _files_allowed(self._limits.connections))
        self._clients: OrderedDict[HttpConnection, asyncio.Task[None]] = OrderedDict()
        """The one that has made no progress for longest is the first."""
        self._tasks: set[asyncio.Task[None]] = set()
        """Those of connections that were reset, too, until they have ended."""

    @property
    def connections(self) -> int:
        return len(self._clients)

    def start(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._listener.setblocking(False)
        self._listener.listen(BACKLOG)
        self._listen()

    def stop_listening(self) -> None:
        """Accept those that have come, and no more; the port refuses connections then."""
        if not self.is_closing:
            self.is_closing = True
            self._loop.remove_reader(self._listener)
            with contextlib.suppress(OSError):
                while True:
                    self._welcome(self._listener.accept()[0])
            self._listener.close()

    async def close(self) -> None:
        """Stop listening, give answers that are under way, and reset the other connections."""
        self.stop_listening()
        for group in ([client for client in self._clients if client.is_idle], self._clients):
            for connection in list(group):
                self._forget(connection).cancel()
            if self._tasks:
                await asyncio.wait(self._tasks, timeout=self._limits.farewell)

    def _listen(self) -> None:
        if not self.is_closing:
            self._loop.add_reader(self._listener, self._accept)

    def _accept(self) -> None:
        # A bounded number, so that those already here have their turn.
        try:
            for _ in range(_ACCEPTED_AT_ONCE):
                self._welcome(self._listener.accept()[0])
        except BlockingIOError:
            pass
        except OSError as error:
            _log.warning("clients are not accepted for %g s: %s", _PAUSE, error)
            self._loop.remove_reader(self._listener)
            self._loop.call_later(_PAUSE, self._listen)

    def _welcome(self, client: socket.socket) -> None:
        client.setblocking(False)
        if len(self._clients) >= self._most:
            self._reset(next(iter(self._clients)))
        connection = HttpConnection(self, client, self._limits.deadline)
        task = self._loop.create_task(connection.serve())
        self._clients[connection] = task
        self._tasks.add(task)
        task.add_done_callback(functools.partial(self._ended, connection))

    def _ended(self, connection: HttpConnection, task: asyncio.Task[None]) -> None:
        connection.close()
        self._tasks.discard(task)
        if connection in self._clients:
            self._forget(connection)
        error = None if task.cancelled() else task.exception()
        if isinstance(error, TimeoutError):
            self.resets += 1
        elif error is not None and not isinstance(error, OSError):
            _log.error("a connection was reset by a defect of the daemon", exc_info=error)

    def _reset(self, connection: HttpConnection) -> None:
        self.resets += 1
        self._forget(connection).cancel()

    def _forget(self, connection: HttpConnection) -> asyncio.Task[None]:
        self.held -= connection.held
        return self._clients.pop(connection)

    # What connections call.

    def progressed(self, connection: HttpConnection) -> None:
        """Put it behind those that have made no progress for longer."""
        self.requests += 1
        if connection in self._clients:
            self._clients.move_to_end(connection)

    def hold(self, connection: HttpConnection, size: int) -> None:
        """Count what a connection holds; reset the oldest clients while all hold too much."""
        if connection not in self._clients:
            return
        self.held += size - connection.held
        connection.held = size
        while self.held > self._limits.memory:
            # A client that holds nothing would free nothing.
            self._reset(next(other for other in self._clients if other.held))


class HttpConnection:
    """Reads at most one request and `_READ_AT_ONCE`; the rest waits in the kernel.

    The socket does not block; ``deadline`` is in seconds, for a request and its answer, and for an
    idle client.
    """

    def __init__(self, server: HttpServer, client: socket.socket, deadline: float) -> None:
        self._server = server
        self._socket = client
        self._deadline = deadline
        self._loop = asyncio.get_running_loop()
        self._received = bytearray()
        self.held = 0
        """Bytes of requests and answers; counted by the server."""
        self.is_idle = False
        """Whether the client was answered, and nothing of another request has come."""
        self._linger(_RESET_ON_CLOSE)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    async def serve(self) -> None:
        """Answer until the client ends the connection.

        Raises ``TimeoutError`` for a client that stands still, and ``OSError`` when it is gone.
        """
        try:
            keep = True
            while keep:
                async with asyncio.timeout(self._deadline):
                    keep = await self._exchange()
                self._server.progressed(self)
                self.is_idle = keep and not self._received
            async with asyncio.timeout(self._deadline):
                while True:
                    self._received.clear()
                    await self._receive()
        except EOFError:
            self._linger(_CLOSE_IN_ORDER)

    def close(self) -> None:
        """Close in order after the client's end, else reset."""
        self._socket.close()

    async def _exchange(self) -> bool:
        try:
            length, keep = parse_head(await self._read_head())
            while len(self._received) < length:
                await self._receive()
        except Rejection as rejection:
            self._received.clear()
            await self._send(rejection.response)
            return False
        body = bytes(self._received[:length])
        del self._received[:length]
        reply = await self._server.answer(body)
        keep = keep and not self._server.is_closing
        await self._send(response(reply, keep_alive=keep))
        return keep

    async def _read_head(self) -> bytes:
        searched = 0
        while True:
            # Python's clients end a request with CRLF; some old ones send one more.
            while self._received[:2] == b"\r\n":
                del self._received[:2]
            # A pattern of four bytes may have begun in what was searched before.
            found = END_OF_HEAD.search(self._received, max(0, searched - 3))
            searched = len(self._received)
            if (found.end() if found else searched) > LONGEST_HEAD:
                raise Rejection(431, "Request Header Fields Too Large")
            if found:
                text = bytes(self._received[: found.start()])
                del self._received[: found.end()]
                return text
            await self._receive()

    async def _receive(self) -> None:
        """Read what has come; raises ``EOFError`` at the client's end."""
        # However fast one client sends, the others have their turn.
        await asyncio.sleep(0)
        data = await self._loop.sock_recv(self._socket, _READ_AT_ONCE)
        if not data:
            raise EOFError
        self.is_idle = False
        self._received += data
        self._server.hold(self, len(self._received))

    async def _send(self, data: bytes) -> None:
        self._server.hold(self, len(self._received) + len(data))
        await self._loop.sock_sendall(self._socket, data)
        self._server.hold(self, len(self._received))

    def _linger(self, how: bytes) -> None:
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, how)


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
