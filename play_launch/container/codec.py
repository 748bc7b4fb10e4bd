"""Messages of the control channel to frames and back, through the layouts of `play_launch_msgs`.

Only what a supervisor sends is encoded and only what a container sends is decoded. A message has
the fields of its class, by name; what differs is spelled out.
"""

from __future__ import annotations

from struct import error as struct_error
from typing import TYPE_CHECKING, Any

from play_launch.config.model import ParameterConfig
from play_launch.container.cdr import messages as layouts
from play_launch.container.frames import Frame, FrameKind, FrameLengthError, encode_frame
from play_launch.container.messages import (
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
    from play_launch.container.cdr.layout import Layout


class MessageError(Exception):
    """A frame does not hold the message that its kind promises, or one that is not for us."""

    def __init__(self, kind: FrameKind, reason: object) -> None:
        super().__init__(f"the payload of a {kind.name} frame cannot be read: {reason}")
        self.kind = kind


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
    except (struct_error, ValueError, FrameLengthError) as error:
        raise EncodeError(message, error) from error


def decode_message(frame: Frame, *, container: str = "") -> Incoming | None:
    """Read the message in a frame of our own protocol version; None for an unknown kind.

    Args:
        frame: The frame.
        container: Full name of the container's node, which events carry.

    Raises:
        MessageError: When the payload is not what the kind promises, or only a supervisor may
            send it.
    """
    try:
        kind = FrameKind(frame.kind)
    except ValueError:
        return None
    try:
        match kind:
            case FrameKind.EVENT:
                event = layouts.COMPONENT_EVENT.read(frame.payload)
                return ComponentEvent(
                    stamp_ns=event.pop("stamp"),
                    kind=ComponentEventKind(event.pop("event_type")),
                    container=container,
                    received=frame.payload,
                    **event,
                )
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
        raise MessageError(kind, error) from error
    raise MessageError(kind, "only a supervisor may send it")


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
