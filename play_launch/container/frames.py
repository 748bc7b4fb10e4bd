"""Framing of the control channel, without any I/O.

A frame is a little-endian `u32` length of what follows it, a `u16` kind, a `u16` protocol version
and the payload.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

PROTOCOL_VERSION = 1
MAX_FRAME_LENGTH = 16 * 1024 * 1024
"""Largest value of the length field, in bytes."""

_LENGTH = struct.Struct("<I")
_HEAD = struct.Struct("<HH")


class FrameKind(IntEnum):
    """What the payload is: the `play_launch_msgs` message named beside each."""

    HELLO = 1
    """ControlHello, in both directions."""
    LOAD = 2
    """ControlLoad, to the container."""
    ACCEPTED = 3
    """ControlAccepted, from the container."""
    REJECTED = 4
    """ControlRejected, from the container."""
    EVENT = 5
    """ComponentEvent, from the container."""
    QUERY = 6
    """ControlQuery, to the container."""
    STATUS = 7
    """ControlStatus, from the container."""
    CANCEL = 8
    """ControlCancel, to the container."""
    UNLOAD = 9
    """ControlUnload, to the container."""
    SHUTDOWN = 10
    """ControlShutdown, to the container."""


class Frame(NamedTuple):
    """One frame; kind and version stay numbers, a newer peer may send some we do not know."""

    kind: int
    version: int
    payload: bytes


class FrameError(Exception):
    """What came cannot be a frame; the rest of the stream has lost its meaning."""


class FrameLengthError(FrameError):
    """The length field has an impossible value."""

    def __init__(self, length: int) -> None:
        super().__init__(
            f"a frame of {length} bytes, allowed are {_HEAD.size} to {MAX_FRAME_LENGTH}"
        )
        self.length = length


class FrameTruncatedError(FrameError):
    """The stream ended inside a frame."""

    def __init__(self, pending: int) -> None:
        super().__init__(f"the stream ended inside a frame, after {pending} bytes of it")
        self.pending = pending


def encode_frame(kind: int, payload: bytes, *, version: int = PROTOCOL_VERSION) -> bytes:
    """Put a payload into a frame.

    Raises:
        FrameLengthError: When the payload is larger than a frame can carry.
    """
    length = _HEAD.size + len(payload)
    if length > MAX_FRAME_LENGTH:
        raise FrameLengthError(length)
    return b"".join((_LENGTH.pack(length), _HEAD.pack(kind, version), payload))


class FrameDecoder:
    """Cuts a byte stream into frames, whatever the sizes of the pieces in which it arrives.

    After an error it is of no use any more and repeats the error.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._error: FrameError | None = None

    @property
    def pending(self) -> int:
        """Bytes held that do not make a whole frame yet."""
        return len(self._buffer)

    @property
    def error(self) -> FrameError | None:
        """Why the stream cannot be read on, where that is so."""
        return self._error

    def feed(self, data: bytes) -> list[Frame]:
        """Take the next piece and give the frames that are complete now.

        Frames in front of a broken one are given first: look at `error` after a call.

        Raises:
            FrameLengthError: On an impossible length.
        """
        if self._error is not None:
            raise self._error
        self._buffer += data
        frames: list[Frame] = []
        start = 0
        while len(self._buffer) - start >= _LENGTH.size:
            (length,) = _LENGTH.unpack_from(self._buffer, start)
            if not _HEAD.size <= length <= MAX_FRAME_LENGTH:
                self._error = FrameLengthError(length)
                break
            body = start + _LENGTH.size
            end = body + length
            if len(self._buffer) < end:
                break
            kind, version = _HEAD.unpack_from(self._buffer, body)
            payload = bytes(memoryview(self._buffer)[body + _HEAD.size : end])
            frames.append(Frame(kind, version, payload))
            start = end
        del self._buffer[:start]
        if self._error is not None and not frames:
            raise self._error
        return frames

    def finish(self) -> None:
        """Say that the stream has ended.

        Raises:
            FrameError: When it ended inside a frame, or was broken before.
        """
        if self._error is not None:
            raise self._error
        if self._buffer:
            raise FrameTruncatedError(len(self._buffer))
