"""``ros2cli.xmlrpc.local_server``: a server that one slow client cannot stop.

Upstream takes one connection after the other and reads each to its end, so that a client which
connects and sends nothing stops all others, and its queue holds five. Here connections are read and
written as they are ready, a request is handled once it is all there, and the answers about the
graph are given again for a fifth of a second. The client closes first: otherwise the port would be
taken for a minute (TIME_WAIT), or a large answer cut off by the reset that upstream ends with.
"""

from __future__ import annotations

import contextlib
import functools
import io
import re
import selectors
import sys
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable
    from types import ModuleType

BACKLOG = 512
"""Connections that the kernel keeps for us; the kernel's own limit is 4096 by default."""
HEARTBEAT = 0.2
"""Seconds after which the loop comes round with nothing to do, and sees signals."""
CACHE_TIME = 0.2
"""Seconds for which an answer about the graph is given again."""
ADDRESS_TIME = 30.0
"""Seconds for which the machine's own addresses are remembered."""
REQUEST_TIME = 10.0
"""Seconds that a client has to send its request and take its answer."""
CLOSING_TIME = 1.0
"""Seconds that a client has to close after its answer."""
MOST_CONNECTIONS = 256
MOST_ANSWERS = 128
LARGEST_HEAD = 64 * 1024
LARGEST_BODY = 1024 * 1024

_LOOP = "_play_launch_loop"
_LENGTH = re.compile(rb"^content-length:[ \t]*(\d{1,9})[ \t]*\r?$", re.IGNORECASE | re.MULTILINE)
_ORIGIN_OR_HOST = re.compile(rb"\n(origin|host)[ \t]*:[ \t]*([^\r\n]*?)[ \t]*\r?\n", re.IGNORECASE)
_OUR_HOST = re.compile(rb"(127\.0\.0\.1|localhost|\[::1\])(:[0-9]{1,5})?", re.IGNORECASE)
_CHUNK = 64 * 1024
_TOO_LARGE = b"HTTP/1.0 413 Request Entity Too Large\r\nContent-Length: 0\r\n\r\n"
_FORBIDDEN = b"HTTP/1.0 403 Forbidden\r\nContent-Length: 0\r\n\r\n"


def apply(module: ModuleType) -> None:
    """Change the class of servers, and the function that lists the machine's addresses."""
    server = module.LocalXMLRPCServer
    addresses = Addresses(module.get_local_ipaddrs)
    verify, close = server.verify_request, server.server_close

    @functools.wraps(verify)
    def verify_request(self: Any, request: Any, client_address: Any) -> bool:
        if verify(self, request, client_address):
            return True
        # Perhaps the address is new.
        addresses.forget()
        return bool(verify(self, request, client_address))

    @functools.wraps(close)
    def server_close(self: Any) -> None:
        loop = self.__dict__.pop(_LOOP, None)
        if loop is not None:
            loop.close()
        close(self)

    module.get_local_ipaddrs = addresses.current  # type: ignore[attr-defined]
    server.verify_request = verify_request
    server.server_close = server_close
    server.handle_request = handle_request
    server.request_queue_size = BACKLOG


def handle_request(self: Any) -> None:
    """Serve the connections that are ready; return after a heartbeat at the latest.

    Calls the server's ``handle_timeout`` as upstream's method does: when no request was answered
    for ``timeout`` seconds. Also when rclpy was shut down by a signal, which the daemon of Humble
    does not look for itself.
    """
    loop = self.__dict__.get(_LOOP)
    if loop is None:
        # Not when the server is made: that is another process, which hands it over.
        loop = self.__dict__[_LOOP] = Loop(self)
    limit = self.timeout
    loop.turn(HEARTBEAT if limit is None else min(HEARTBEAT, limit))
    idle = time.monotonic() - loop.last_answer
    if (limit is not None and idle >= limit) or _rclpy_has_ended():
        self.handle_timeout()


def _rclpy_has_ended() -> bool:
    rclpy = sys.modules.get("rclpy")
    return rclpy is not None and not rclpy.ok()


class Addresses:
    """The machine's own addresses, remembered for a while."""

    def __init__(self, look: Callable[[], list[str]]) -> None:
        self._look = look
        self._found: list[str] = []
        self._until = 0.0

    def current(self) -> list[str]:
        """Return the addresses, at most ``ADDRESS_TIME`` old."""
        now = time.monotonic()
        if now >= self._until:
            self._found = self._look()
            self._until = now + ADDRESS_TIME
        return list(self._found)

    def forget(self) -> None:
        """Look again next time."""
        self._until = 0.0


class Connection:
    """One client: what it has sent so far, and what it is still to get."""

    def __init__(self, sock: socket.socket, address: Any) -> None:
        self.socket = sock
        self.address = address
        self.received = bytearray()
        self.answer = memoryview(b"")
        self.is_answered = False
        self.deadline = time.monotonic() + REQUEST_TIME


class Loop:
    """Serves the connections of one server, in one thread."""

    def __init__(self, server: Any) -> None:
        self.last_answer = time.monotonic()
        self._server = server
        self._connections: dict[socket.socket, Connection] = {}
        self._answers: dict[bytes, tuple[float, bytes]] = {}
        self._selector = selectors.DefaultSelector()
        # The process that made the server may not have had this overlay.
        server.socket.listen(BACKLOG)
        server.socket.setblocking(False)
        self._selector.register(server.socket, selectors.EVENT_READ)

    def turn(self, wait: float) -> None:
        """Wait up to ``wait`` seconds, and serve the connections that are ready."""
        for key, events in self._selector.select(wait):
            if key.fileobj is self._server.socket:
                self._accept()
            elif key.fileobj in self._connections:
                self._serve(self._connections[key.fileobj], events)
        now = time.monotonic()
        for connection in [c for c in self._connections.values() if c.deadline <= now]:
            self._drop(connection)

    def close(self) -> None:
        """Close all connections."""
        for connection in list(self._connections.values()):
            self._drop(connection)
        self._selector.close()

    def _accept(self) -> None:
        # A bounded number, so that those already here have their turn.
        for _ in range(64):
            try:
                sock, address = self._server.get_request()
            except OSError:
                return
            if not self._server.verify_request(sock, address):
                sock.close()
                continue
            if len(self._connections) >= MOST_CONNECTIONS:
                # The one that has had the most time.
                self._drop(min(self._connections.values(), key=lambda c: c.deadline))
            sock.setblocking(False)
            self._connections[sock] = Connection(sock, address)
            self._selector.register(sock, selectors.EVENT_READ)

    def _serve(self, connection: Connection, events: int) -> None:
        try:
            if events & selectors.EVENT_WRITE:
                self._write(connection)
            else:
                self._read(connection)
        except BlockingIOError:
            pass
        except OSError:
            self._drop(connection)

    def _read(self, connection: Connection) -> None:
        data = connection.socket.recv(_CHUNK)
        if not data:
            self._drop(connection)
            return
        if connection.is_answered:
            return  # What comes after the request is not looked at.
        connection.received += data
        length = _request_length(connection.received)
        if length is None:
            connection.answer = memoryview(_TOO_LARGE)
        elif 0 < length <= len(connection.received):
            request = bytes(connection.received[:length])
            forbidden = _is_of_the_web(request)
            answer = _FORBIDDEN if forbidden else self._answer(request, connection.address)
            connection.answer = memoryview(answer)
        else:
            return
        connection.is_answered = True
        connection.received.clear()
        if not connection.answer:
            self._drop(connection)
            return
        self._write(connection)

    def _write(self, connection: Connection) -> None:
        with contextlib.suppress(BlockingIOError):
            sent = connection.socket.send(connection.answer)
            connection.answer = connection.answer[sent:]
        if connection.answer:
            self._selector.modify(connection.socket, selectors.EVENT_WRITE)
            return
        connection.deadline = time.monotonic() + CLOSING_TIME
        self._selector.modify(connection.socket, selectors.EVENT_READ)

    def _answer(self, request: bytes, address: Any) -> bytes:
        now = time.monotonic()
        self.last_answer = now
        known = self._answers.get(request)
        if known is not None and now < known[0]:
            return known[1]
        exchange = Exchange(request)
        try:
            self._server.finish_request(exchange, address)
        except Exception:  # noqa: BLE001 - as upstream's server does
            self._server.handle_error(exchange, address)
        answer = exchange.answer()
        # From the end of the call: it may have taken long.
        self.last_answer = time.monotonic()
        if _asks_for_the_graph(request) and _is_no_failure(answer):
            self._remember(request, answer, self.last_answer)
        return answer

    def _remember(self, request: bytes, answer: bytes, now: float) -> None:
        if len(self._answers) >= MOST_ANSWERS:
            self._answers = {key: kept for key, kept in self._answers.items() if now < kept[0]}
            if len(self._answers) >= MOST_ANSWERS:
                self._answers.clear()
        self._answers[request] = (now + CACHE_TIME, answer)

    def _drop(self, connection: Connection) -> None:
        del self._connections[connection.socket]
        self._selector.unregister(connection.socket)
        connection.socket.close()


class Exchange:
    """What the standard library's request handler takes for a connection: memory only."""

    def __init__(self, request: bytes) -> None:
        self._request = io.BytesIO(request)
        self._answer = _Kept()

    def makefile(self, mode: str, _buffering: int = -1) -> io.BytesIO:
        """Give the request to read, or the answer to write."""
        return self._request if "r" in mode else self._answer

    def sendall(self, data: bytes) -> None:
        """Add to the answer."""
        self._answer.write(data)

    def settimeout(self, seconds: float | None) -> None:
        """Memory is never late."""

    def setsockopt(self, level: int, option: int, value: object) -> None:
        """Memory has no options."""

    def answer(self) -> bytes:
        """Return what was written."""
        return self._answer.getvalue()


class _Kept(io.BytesIO):
    """Memory that survives the handler's closing of its files."""

    def close(self) -> None:
        pass


def _request_length(received: bytearray) -> int | None:
    """Return the length of the request: 0 while its head is incomplete, None if too large."""
    end = received.find(b"\r\n\r\n")
    if end < 0:
        return 0 if len(received) < LARGEST_HEAD else None
    if end > LARGEST_HEAD:
        return None
    # To the end of the last line of the head, so that the pattern finds its end.
    length = _LENGTH.search(received, 0, end + 1)
    body = int(length[1]) if length else 0
    return end + 4 + body if body <= LARGEST_BODY else None


def _is_of_the_web(request: bytes) -> bool:
    """Whether a page of the web asks, which may not, and not shut the daemon down.

    Only browsers send an origin; and a name that was made to point to this machine is not ours.
    """
    # Each line with the end of the one before it, which is the end of a match, too.
    head = request[: request.find(b"\r\n\r\n") + 2].replace(b"\n", b"\n\n")
    return any(
        name.lower() == b"origin" or not _OUR_HOST.fullmatch(value)
        for name, value in _ORIGIN_OR_HOST.findall(head)
    )


def _asks_for_the_graph(request: bytes) -> bool:
    return b"<methodName>get_" in request or b"<methodName>count_" in request


def _is_no_failure(answer: bytes) -> bool:
    # A fault is near the beginning, unless it is long and packed; then it is kept for a moment.
    return answer.startswith(b"HTTP/1.0 200 ") and b"<fault>" not in answer[:1024]
