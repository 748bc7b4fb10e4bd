"""The supervisor's end of a control channel.

One socket pair per container, ordered and lossless. The end of the stream means that the other
side is gone.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from typing import TYPE_CHECKING

from play_launch.container.codec import (
    MAX_FRAME_LENGTH,
    ControlError,
    Frame,
    FrameDecoder,
    decode_message,
    encode_message,
)
from play_launch.container.messages import PROTOCOL_VERSION, Hello

if TYPE_CHECKING:
    import socket

    from play_launch.container.messages import Incoming, Outgoing

CONTROL_FD_VARIABLE = "PLAY_LAUNCH_CONTROL_FD"
"""Environment variable that names the container's end."""
MAX_OUTGOING_BYTES = 2 * MAX_FRAME_LENGTH
"""A container that leaves more than this unread is broken."""
MAX_QUEUED_FRAMES = 1024
"""With this many frames not yet received, the socket is left alone and the container waits."""
_READ_BYTES = 256 * 1024

_log = logging.getLogger(__name__)


class ChannelClosedError(ControlError):
    """The container is gone or has closed its end, or we have closed ours."""


class VersionMismatchError(ControlError):
    """The container speaks another version of the protocol; another start changes nothing."""

    def __init__(self, version: int) -> None:
        super().__init__(
            f"the container speaks version {version} of the control protocol, this supervisor "
            f"version {PROTOCOL_VERSION}: install both from the same release"
        )
        self.version = version


class ControlChannel:
    """Talks to one container over our end of a control channel; it owns that socket.

    Reading: `receive`, or iterate; one reader at a time. Reading stops while
    `MAX_QUEUED_FRAMES` frames wait, so a slow reader slows the container down and nothing is
    lost. What arrived before an error is given first, then each call raises that error.

    Sending never waits: what the socket does not take is kept, up to `MAX_OUTGOING_BYTES`.
    """

    def __init__(self, ours: socket.socket, *, container: str) -> None:
        """Take over a connected socket.

        Args:
            ours: The socket.
            container: Full name of the container's node, which its events carry.
        """
        ours.setblocking(False)
        self.container = container
        self._socket = ours
        self._loop = asyncio.get_running_loop()
        self._decoder = FrameDecoder()
        self._frames: deque[Frame] = deque()
        self._outgoing = bytearray()
        self._arrived = asyncio.Event()
        self._error: ControlError | None = None
        self._send_error: ControlError | None = None
        self._reading = False
        self._read_on()

    async def handshake(self, hello: Hello) -> Hello:
        """Wait for the container's hello and answer it.

        Raises:
            VersionMismatchError: When it speaks another version; it is not answered then.
            ChannelClosedError: When it is gone before.
            ControlError: When it says something else first.
        """
        first = await self.receive()
        if not isinstance(first, Hello):
            raise self._fail(ControlError(f"a {type(first).__name__} came instead of a hello"))
        if first.protocol_version != PROTOCOL_VERSION:
            raise self._fail(VersionMismatchError(first.protocol_version))
        self.send(hello)
        return first

    async def receive(self) -> Incoming:
        """Wait for the next message; frames of an unknown kind are skipped.

        Raises:
            ControlError: When the channel is of no use any more.
        """
        while True:
            while self._frames:
                frame = self._frames.popleft()
                if not self._reading and len(self._frames) <= MAX_QUEUED_FRAMES // 2:
                    self._read_on()
                if frame.version != PROTOCOL_VERSION:
                    self._frames.clear()
                    raise self._fail(VersionMismatchError(frame.version))
                try:
                    message = decode_message(frame, container=self.container)
                except ControlError as error:
                    self._frames.clear()
                    raise self._fail(error) from None
                if message is not None:
                    return message
                _log.warning("%s sent a frame of unknown kind %d", self.container, frame.kind)
            if self._error is not None:
                raise self._error
            self._arrived.clear()
            await self._arrived.wait()

    def send(self, message: Outgoing) -> None:
        """Send a message, without waiting.

        Raises:
            ControlError: When the channel is of no use any more.
            EncodeError: When a value does not fit into the message; nothing is sent then.
        """
        error = self._error or self._send_error
        if error is not None:
            raise error
        self._outgoing += encode_message(message)
        if len(self._outgoing) > MAX_OUTGOING_BYTES:
            waiting = len(self._outgoing)
            raise self._fail(ControlError(f"the container does not read: {waiting} bytes wait"))
        self._write()

    def close(self) -> None:
        """Close the channel, upon which the container stops. May be called twice."""
        self._frames.clear()
        self._fail(ChannelClosedError("the control channel was closed by the supervisor"))

    def __repr__(self) -> str:
        state = "open" if self._error is None else str(self._error)
        return f"<ControlChannel to {self.container}: {state}>"

    def _fail(self, error: ControlError) -> ControlError:
        """End the channel for this reason unless it has ended before; return the reason."""
        if self._error is None:
            self._error = error
            if self._reading:
                self._loop.remove_reader(self._socket)
                self._reading = False
            self._loop.remove_writer(self._socket)
            self._outgoing.clear()
            self._socket.close()
            self._arrived.set()
        return self._error

    def _read_on(self) -> None:
        if self._error is None:
            self._loop.add_reader(self._socket, self._read)
            self._reading = True

    def _read(self) -> None:
        try:
            data = self._socket.recv(_READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._fail(ChannelClosedError(f"the control channel broke: {error.strerror}"))
            return
        if not data:
            inside = f", inside a frame ({self._decoder.pending} bytes of it)"
            self._fail(
                ChannelClosedError(
                    "the container closed the control channel"
                    + (inside if self._decoder.pending else "")
                )
            )
            return
        self._frames.extend(self._decoder.feed(data))
        if self._decoder.error:
            self._fail(ControlError(self._decoder.error))
        elif len(self._frames) >= MAX_QUEUED_FRAMES:
            self._loop.remove_reader(self._socket)
            self._reading = False
        self._arrived.set()

    def _write(self) -> None:
        try:
            sent = self._socket.send(self._outgoing)
        except (BlockingIOError, InterruptedError):
            sent = 0
        except OSError as error:
            # What the container said before it died is still to be read: the reading side ends
            # the channel.
            self._send_error = ChannelClosedError(f"the container is gone: {error.strerror}")
            self._loop.remove_writer(self._socket)
            self._outgoing.clear()
            return
        del self._outgoing[:sent]
        if self._outgoing:
            self._loop.add_writer(self._socket, self._write)
        else:
            self._loop.remove_writer(self._socket)
