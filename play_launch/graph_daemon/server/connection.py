"""One client: reads requests, answers them one after the other, and lets the client close first.

Whoever closes a TCP connection first keeps its port busy for a minute (TIME_WAIT), and ros2cli's
own daemon cannot start while our port is busy. So a connection is closed after the client's end of
it, or else by a reset: at its deadline, or when it takes too much. Until the client's end has come
the socket is set to be reset on closing, so that even a killed daemon leaves nothing behind.
"""

from __future__ import annotations

import asyncio
import socket
import struct
from enum import Enum, auto
from typing import TYPE_CHECKING, Final, Protocol, cast

from play_launch.graph_daemon.server.http import Rejection, Request, RequestReader, response

if TYPE_CHECKING:
    from collections.abc import Callable

_RESET_ON_CLOSE: Final = struct.pack("ii", 1, 0)
_CLOSE_IN_ORDER: Final = struct.pack("ii", 0, 0)


class Owner(Protocol):
    """What a connection wants of the server."""

    read_buffer: bytearray
    """Shared by all connections: it is emptied before another one reads."""

    def opened(self, connection: Connection) -> None:
        """A client has come; its deadline begins."""

    def progressed(self, connection: Connection) -> None:
        """A request was answered and the answer was taken; the deadline begins anew."""

    def resized(self, connection: Connection) -> None:
        """What the connection holds has changed."""

    def closed(self, connection: Connection) -> None:
        """The connection is gone."""

    def answer(self, body: bytes, reply: Callable[[bytes], None]) -> None:
        """Answer a request by calling ``reply`` in the loop's thread, now or later."""

    @property
    def is_closing(self) -> bool:
        """Whether connections may not be kept any more."""


class _State(Enum):
    READING = auto()
    ANSWERING = auto()
    """A request was given to the server."""
    WRITING = auto()
    """The client has not taken all of its answer."""
    ENDING = auto()
    """The last answer was given; the client is to close."""


_BUSY: Final = frozenset({_State.ANSWERING, _State.WRITING})


class Connection(asyncio.BufferedProtocol):
    """asyncio's protocol for one client of the daemon."""

    def __init__(self, owner: Owner) -> None:
        self._owner = owner
        self._reader = RequestReader()
        self._state = _State.READING
        self._keep = True
        self._served = False
        self._ended = False
        """The client has sent its last byte."""
        self.deadline = 0.0
        """When it is reset, in the loop's time; kept by the server."""
        self.accounted = 0
        """Bytes that the server has counted; kept by the server."""

    @property
    def held(self) -> int:
        """Bytes of requests and answers that are held for this client."""
        transport = getattr(self, "_transport", None)
        waiting = 0 if transport is None else transport.get_write_buffer_size()
        return len(self._reader) + waiting

    @property
    def is_idle(self) -> bool:
        """Whether the client was answered, and nothing of another request has come."""
        return self._served and self._state is _State.READING and not len(self._reader)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin."""
        self._transport = cast("asyncio.Transport", transport)
        # With this limit every byte that the kernel does not take is reported.
        self._transport.set_write_buffer_limits(high=0)
        self._linger(_RESET_ON_CLOSE)
        self._owner.opened(self)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002
        """End."""
        self._ended = True
        self._owner.closed(self)

    def get_buffer(self, sizehint: int) -> bytearray:  # noqa: ARG002
        """Where to read to."""
        return self._owner.read_buffer

    def buffer_updated(self, nbytes: int) -> None:
        """Take what was read."""
        if self._state is _State.ENDING:
            return
        self._reader.feed(memoryview(self._owner.read_buffer)[:nbytes])
        self._advance()
        self._owner.resized(self)

    def eof_received(self) -> bool:
        """Close in order, as soon as the answer that is under way was taken."""
        self._ended = True
        self._linger(_CLOSE_IN_ORDER)
        return self._state in _BUSY and not self._transport.is_closing()

    def pause_writing(self) -> None:
        """The client does not take its answer at once."""
        self._state = _State.WRITING

    def resume_writing(self) -> None:
        """It has taken all of it."""
        self._state = _State.ANSWERING
        self._answered()
        self._owner.resized(self)

    def abort(self) -> None:
        """Reset the connection."""
        # `abort` alone would send what is buffered into a void, and close in order.
        self._linger(_RESET_ON_CLOSE)
        self._transport.abort()

    def _advance(self) -> None:
        while self._state is _State.READING:
            found = self._reader.next()
            if found is None:
                return
            if isinstance(found, Rejection):
                self._keep = False
                self._state = _State.ANSWERING
                self._send(found.response)
                return
            self._take(found)

    def _take(self, request: Request) -> None:
        self._state = _State.ANSWERING
        self._keep = request.keep_alive
        self._owner.answer(request.body, self._reply)
        if self._state in _BUSY and not self._transport.is_closing():
            # What else the client sends waits in the kernel.
            self._transport.pause_reading()

    def _reply(self, body: bytes) -> None:
        if self._transport.is_closing() or self._state is not _State.ANSWERING:
            return
        self._keep = self._keep and not self._owner.is_closing
        self._send(response(body, keep_alive=self._keep))

    def _send(self, data: bytes) -> None:
        self._transport.write(data)
        if self._state is _State.ANSWERING:
            self._answered()
        self._owner.resized(self)

    def _answered(self) -> None:
        self._served = True
        self._owner.progressed(self)
        if self._ended:
            self._transport.close()
            return
        self._state = _State.READING if self._keep else _State.ENDING
        # Reading goes on in any case: that is how the client's end is noticed.
        if not self._transport.is_reading() and not self._transport.is_closing():
            self._transport.resume_reading()
            asyncio.get_running_loop().call_soon(self._advance)

    def _linger(self, how: bytes) -> None:
        found = self._transport.get_extra_info("socket")
        if found is not None and found.fileno() >= 0:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, how)
