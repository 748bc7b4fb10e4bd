"""Messages of the control channel to frames and back, without any I/O.

A frame is a little-endian `u32` length of what follows it, a `u16` kind, a `u16` protocol version
and the payload: a message of `play_launch_msgs`. Only what a supervisor sends is encoded and only
what a container sends is decoded.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from struct import error as struct_error
from typing import TYPE_CHECKING, Any, NamedTuple

from play_launch.config.model import ParameterConfig
from play_launch.container.cdr import messages as layouts
from play_launch.container.messages import (
    PROTOCOL_VERSION,
    Accepted,
    Cancel,
    Hello,
    Incoming,
    Load,
    NodeStatus,
    NodeStatusState,
    Outgoing,
    Query,
    Rejected,
    Shutdown,
    Status,
    Unload,
)
from play_launch.supervisor.events import ComponentEvent, ComponentEventKind

if TYPE_CHECKING:
    from play_launch.container.cdr.structure import Layout


MAX_FRAME_LENGTH = 16 * 1024 * 1024
"""Largest value of the length field, in bytes."""

_LENGTH = struct.Struct("<I")
_HEAD = struct.Struct("<HH")
_BAD_LENGTH = f"a frame of {{}} bytes, allowed are {_HEAD.size} to {MAX_FRAME_LENGTH}"


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


class ControlError(Exception):
    """The channel cannot be used; the container has to be stopped."""


def encode_frame(kind: int, payload: bytes, *, version: int = PROTOCOL_VERSION) -> bytes:
    """Put a payload into a frame.

    Raises:
        ValueError: When the payload is larger than a frame can carry.
    """
    length = _HEAD.size + len(payload)
    if length > MAX_FRAME_LENGTH:
        raise ValueError(_BAD_LENGTH.format(length))
    return b"".join((_LENGTH.pack(length), _HEAD.pack(kind, version), payload))


class FrameDecoder:
    """Cuts a byte stream into frames, whatever the sizes of the pieces in which it arrives."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.error = ""
        """Why the rest of the stream has lost its meaning, if so."""

    @property
    def pending(self) -> int:
        """Bytes held that do not make a whole frame yet."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Frame]:
        """Take the next piece and give the frames that are complete now; check `error` then."""
        if self.error:
            return []
        self._buffer += data
        frames: list[Frame] = []
        start = 0
        while len(self._buffer) - start >= _LENGTH.size:
            (length,) = _LENGTH.unpack_from(self._buffer, start)
            if not _HEAD.size <= length <= MAX_FRAME_LENGTH:
                self.error = _BAD_LENGTH.format(length)
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
        return frames


class EncodeError(Exception):
    """A message cannot be put into a frame: a value does not fit, or it is too large."""

    def __init__(self, message: Outgoing, reason: object) -> None:
        super().__init__(f"a {type(message).__name__} cannot be sent: {reason}")
        self.message = message


def encode_message(message: Outgoing) -> bytes:
    """Make the frame of a message.

    Raises:
        EncodeError: When a value is out of its field's range, or the whole does not fit a frame.
    """
    kind, layout = _SENT[type(message)]
    try:
        return encode_frame(
            kind,
            layout.write({name: _value(getattr(message, name)) for name in layout.types}),
        )
    except (struct_error, ValueError) as error:
        raise EncodeError(message, error) from error


def decode_message(frame: Frame, *, container: str = "") -> Incoming | None:
    """Read the message in a frame of our own protocol version; None for an unknown kind.

    Args:
        frame: The frame.
        container: Full name of the container's node, which events carry.

    Raises:
        ControlError: When the payload is not what the kind promises, or only a supervisor may
            send it.
    """
    try:
        kind = FrameKind(frame.kind)
    except ValueError:
        return None
    unreadable = f"the payload of a {kind.name} frame cannot be read"
    try:
        match kind:
            case FrameKind.EVENT:
                event = layouts.COMPONENT_EVENT.read(frame.payload)
                event |= {"stamp_ns": event.pop("stamp"), "container": container}
                return ComponentEvent(kind=ComponentEventKind(event.pop("event_type")), **event)
            case FrameKind.STATUS:
                status = layouts.CONTROL_STATUS.read(frame.payload)
                nodes = tuple(
                    NodeStatus(**{**node, "state": NodeStatusState(node["state"])})
                    for node in status.pop("nodes")
                )
                return Status(**status, nodes=nodes)
            case FrameKind.HELLO:
                return Hello(**layouts.CONTROL_HELLO.read(frame.payload))
            case FrameKind.ACCEPTED:
                return Accepted(**layouts.CONTROL_ACCEPTED.read(frame.payload))
            case FrameKind.REJECTED:
                return Rejected(**layouts.CONTROL_REJECTED.read(frame.payload))
    except ValueError as error:  # CdrError, and numbers that no enumeration has
        raise ControlError(f"{unreadable}: {error}") from error
    raise ControlError(f"{unreadable}: only a supervisor may send it")


_SENT: dict[type[Outgoing], tuple[FrameKind, Layout]] = {
    Hello: (FrameKind.HELLO, layouts.CONTROL_HELLO),
    Load: (FrameKind.LOAD, layouts.CONTROL_LOAD),
    Query: (FrameKind.QUERY, layouts.CONTROL_QUERY),
    Cancel: (FrameKind.CANCEL, layouts.CONTROL_CANCEL),
    Unload: (FrameKind.UNLOAD, layouts.CONTROL_UNLOAD),
    Shutdown: (FrameKind.SHUTDOWN, layouts.CONTROL_SHUTDOWN),
}


def _value(value: Any) -> Any:
    match value:
        case str():
            if "\0" in value:
                raise ValueError("a string of ROS holds no NUL")
            value.encode()  # raises for half of a surrogate pair, which Layout would escape
        case tuple():
            return tuple(map(_value, value))
        case ParameterConfig(name=name, value=parameter):
            payload = _value(parameter.value)
            return {
                "name": _value(name),
                "value": {"type": parameter.type, parameter.type.field: payload},
            }
    return value
