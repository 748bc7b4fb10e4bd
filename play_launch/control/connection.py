"""One client of the control socket, with bounds for everything that it could make grow."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Protocol, cast

from play_launch.control.place import Peer, peer_of
from play_launch.control.protocol import (
    LONGEST_ANSWER,
    LONGEST_REQUEST,
    Code,
    ControlError,
    LineSplitter,
    Request,
    encode,
    request_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

MOST_AT_ONCE: Final = 16
"""Requests of one client that are under way; further ones wait, unread, in its socket."""
MOST_UNREAD: Final = 1024 * 1024
"""Bytes that wait for a client to read them; beyond, no request of it is begun and nothing is
streamed to it."""
OWN_ROOM: Final = 64 * 1024
"""Bytes of requests that every client may have in memory, whatever others have."""
_log = logging.getLogger(__name__)


class Room:
    """Memory for what clients send beyond their own room, in bytes; all of them share it."""

    def __init__(self, size: int) -> None:
        """Have so much."""
        self._free = size

    def change(self, before: int, after: int) -> bool:
        """Let somebody who has ``before`` have ``after``; False where there is not enough."""
        if after - before > self._free:
            return False
        self._free -= after - before
        return True


class Stream(Protocol):
    """What an operation says before its result."""

    async def send(self, kind: str, value: object) -> None:
        """Send a value under a name, when the client has read most of what was sent before."""


class Operate(Protocol):
    """Carries out requests."""

    async def __call__(self, request: Request, peer: Peer, stream: Stream) -> object:
        """Return the result; raises ControlError."""


class Connection(asyncio.Protocol):
    """Belongs to the thread of the event loop; whatever the client does, this is all it affects."""

    def __init__(
        self,
        *,
        greeting: bytes,
        operate: Operate,
        room: Room,
        admits: Callable[[Connection, Peer], str],
        spawn: Callable[[Coroutine[Any, Any, None]], asyncio.Task[None]],
        on_end: Callable[[Connection], None],
    ) -> None:
        """Serve a client.

        Args:
            greeting: The first line to it.
            operate: Carries out its requests.
            room: For its long requests.
            admits: Says why it may not talk to us; empty: it may.
            spawn: Begins a task.
            on_end: Is called when it has gone.
        """
        self._greeting = greeting
        self._operate = operate
        self._room = room
        self._taken = 0
        self._admits = admits
        self._spawn = spawn
        self._on_end = on_end
        self._splitter = LineSplitter(LONGEST_REQUEST)
        self._transport: asyncio.Transport | None = None
        self._peer = Peer(0, -1, -1)
        self._waiting: deque[tuple[Request, int]] = deque()
        self._size = 0
        """Bytes of the requests that wait or are under way."""
        self._tasks: set[asyncio.Task[None]] = set()
        self.is_read = asyncio.Event()
        """Set unless more is unread than there may be."""
        self.is_read.set()
        self._is_reading = True

    def close(self) -> None:
        """End it; what was not read yet is still sent."""
        if self._transport is not None:
            self._transport.close()

    def abort(self) -> None:
        """End it at once."""
        if self._transport is not None:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Greet."""
        self._transport = cast("asyncio.Transport", transport)
        self._transport.set_write_buffer_limits(high=MOST_UNREAD)
        try:
            peer = peer_of(transport.get_extra_info("socket"))
        except OSError:
            self._transport.abort()
            return
        if why_not := self._admits(self, peer):
            self._refuse(ControlError(Code.NOT_ALLOWED, why_not))
            return
        self._peer = peer
        self._transport.write(self._greeting)

    def data_received(self, data: bytes) -> None:
        """Take requests; what is none ends the connection."""
        try:
            lines = self._splitter.feed(data)
            self._size += sum(len(line) for line in lines)
            self._take_room()  # before anything is made of them that takes more
            self._waiting += [(request_of(line), len(line)) for line in lines]
        except ControlError as error:
            self._refuse(error)
            return
        self._go_on()

    def pause_writing(self) -> None:
        """It does not read what we say."""
        self.is_read.clear()
        self._go_on()

    def resume_writing(self) -> None:
        """It reads again."""
        self.is_read.set()
        self._go_on()

    def connection_lost(self, error: Exception | None) -> None:  # noqa: ARG002 - asyncio's
        """It has gone; nobody waits for what is under way."""
        self._transport = None
        self._waiting.clear()
        for task in self._tasks:
            task.cancel()
        self._room.change(self._taken, 0)
        self._taken = 0
        self._on_end(self)

    def write(self, line: bytes) -> None:
        """Send a line; one that nobody can receive any more is dropped."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(line)

    def _take_room(self) -> None:
        """Take what its requests need, or give back what they do not need any more.

        Raises:
            ControlError: When there is not enough for all.
        """
        wanted = max(self._size + self._splitter.unfinished - OWN_ROOM, 0)
        if not self._room.change(self._taken, wanted):
            raise ControlError(Code.TOO_MANY, "too many long requests at once; try again")
        self._taken = wanted

    def _refuse(self, error: ControlError) -> None:
        self._waiting.clear()
        self.write(encode({"id": None, "error": error.as_object()}))
        self.close()

    def _go_on(self) -> None:
        """Begin what waits, as far as it may; read on when nothing waits."""
        if self._transport is None or self._transport.is_closing():
            return
        while self._waiting and self.is_read.is_set() and len(self._tasks) < MOST_AT_ONCE:
            request, size = self._waiting.popleft()
            task = self._spawn(self._carry_out(request))
            self._tasks.add(task)
            task.add_done_callback(partial(self._is_done, size))
        reads = not self._waiting
        if reads is not self._is_reading:
            self._is_reading = reads
            (self._transport.resume_reading if reads else self._transport.pause_reading)()

    def _is_done(self, size: int, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        self._size -= size
        if self._transport is not None:
            self._take_room()
        self._go_on()

    async def _carry_out(self, request: Request) -> None:
        self.write(await self._answer(request))

    async def _answer(self, request: Request) -> bytes:
        try:
            stream = _Stream(self, request.id)
            peer = self._peer._replace(command=request.command)
            result = await self._operate(request, peer, stream)
            line = encode({"id": request.id, "result": result})
            if len(line) <= LONGEST_ANSWER:
                return line
            error = ControlError(Code.TOO_LONG, "the answer is too long; ask for less at once")
        except ControlError as refused:
            error = refused
        except Exception as mistake:  # noqa: BLE001 - it is logged, and the run goes on
            _log.exception("the control request %r failed", request.operation)
            error = ControlError(Code.INTERNAL, f"{type(mistake).__name__}: {mistake}")
        return encode({"id": request.id, "error": error.as_object()})


class _Stream:
    """What one request streams."""

    def __init__(self, connection: Connection, number: int) -> None:
        self._connection = connection
        self._number = number

    async def send(self, kind: str, value: object) -> None:
        await self._connection.is_read.wait()
        self._connection.write(encode({"id": self._number, kind: value}))
