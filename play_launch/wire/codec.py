"""Messages of the control channel to frames and back, through their `play_launch_msgs` messages.

Only what a supervisor sends is encoded and only what a container sends is decoded. A message has
the fields of its dataclass, by name; what differs is spelled out.

rclpy and the generated messages are imported on the first conversion (about 0.1 s): call
`preload` in another thread before.
"""

from __future__ import annotations

import threading
from dataclasses import fields
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

from play_launch.config.model import ParameterConfig
from play_launch.core.events import ComponentEvent, ComponentEventKind
from play_launch.wire.frames import Frame, FrameKind, encode_frame
from play_launch.wire.messages import (
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
from play_launch.wire.parameters import to_parameter_message

if TYPE_CHECKING:
    from collections.abc import Callable

_T = TypeVar("_T")
_NANOSECONDS = 1_000_000_000


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


def is_loaded() -> bool:
    """Whether `preload` has nothing left to do."""
    return _ros.cache_info().currsize > 0


def preload() -> None:
    """Import what the conversions need, once, whichever thread comes first.

    Raises:
        ImportError: When rclpy or play_launch_msgs is not there or does not load.
    """
    try:
        with _loading:
            _ros()
    except ImportError:
        raise
    except Exception as error:  # rosidl's own type of error is none of ImportError
        raise ImportError(str(error)) from error


_loading = threading.Lock()


def encode_message(message: Outgoing) -> bytes:
    """Make the frame of a message.

    Raises:
        EncodeError: When a value is out of its field's range, or the whole does not fit a frame.
    """
    ros = _ros()
    kind = _SENT[type(message)]
    try:
        # Unchecked, numbers out of range are wrapped and wrong types crash.
        made = ros.types[kind](check_fields=True)
        for field in fields(message):
            setattr(made, field.name, _ros_value(getattr(message, field.name)))
        return encode_frame(kind, bytes(ros.serialize(made)))
    except Exception as error:  # what rclpy raises differs with the field and with python -O
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
    ros = _ros()
    try:
        message = ros.deserialize(frame.payload, ros.types[kind])
        match kind:
            case FrameKind.HELLO:
                return _copied(Hello, message)
            case FrameKind.ACCEPTED:
                return _copied(Accepted, message)
            case FrameKind.REJECTED:
                return _copied(Rejected, message)
            case FrameKind.STATUS:
                nodes = (
                    _copied(NodeStatus, node, state=NodeStatusState(node.state))
                    for node in message.nodes
                )
                return _copied(Status, message, nodes=tuple(nodes))
            case FrameKind.EVENT:
                return _copied(
                    ComponentEvent,
                    message,
                    stamp_ns=message.stamp.sec * _NANOSECONDS + message.stamp.nanosec,
                    kind=ComponentEventKind(message.event_type),
                    container=container,
                    received=frame.payload,
                )
    except Exception as error:  # rclpy's own type of error is private
        raise MessageError(kind, error) from error
    raise MessageError(kind, "only a supervisor may send it")


class _Ros:
    """The ROS side of the conversions, imported late."""

    def __init__(self) -> None:
        import play_launch_msgs.msg as msgs  # noqa: PLC0415
        from rclpy.serialization import (  # noqa: PLC0415
            deserialize_message,
            serialize_message,
        )

        self.serialize: Callable[[Any], Any] = serialize_message
        self.deserialize: Callable[[bytes, Any], Any] = deserialize_message
        self.types: dict[FrameKind, Any] = {
            kind: msgs.ComponentEvent
            if kind is FrameKind.EVENT
            else getattr(msgs, f"Control{kind.name.title()}")
            for kind in FrameKind
        }
        for message_type in self.types.values():
            self.serialize(message_type())  # loads its type support


@cache
def _ros() -> _Ros:
    return _Ros()


_SENT: dict[type[Outgoing], FrameKind] = {
    Hello: FrameKind.HELLO,
    Load: FrameKind.LOAD,
    Query: FrameKind.QUERY,
    Cancel: FrameKind.CANCEL,
    Unload: FrameKind.UNLOAD,
    Shutdown: FrameKind.SHUTDOWN,
}


def _ros_value(value: object) -> Any:
    if isinstance(value, tuple):
        return [_ros_value(item) for item in value]
    return to_parameter_message(value) if isinstance(value, ParameterConfig) else value


def _copied(kind: type[_T], message: Any, /, **given: Any) -> _T:
    """Make a value whose fields are those of a ROS message, besides those that are `given`."""
    shape: Any = kind  # a dataclass; its fields come from its class
    for name in (field.name for field in fields(shape)):
        if name not in given:
            value = getattr(message, name)
            given[name] = value if isinstance(value, (int, str)) else tuple(value)
    return kind(**given)
