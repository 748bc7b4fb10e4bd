"""Messages of the control channel to frames and back, through their `play_launch_msgs` messages.

rclpy and the generated messages are imported on the first conversion (about 0.1 s): call
`preload` before the event loop has work to do.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from play_launch.core.events import ComponentEvent, ComponentEventKind
from play_launch.wire.frames import Frame, FrameKind, encode_frame
from play_launch.wire.messages import (
    Accepted,
    Cancel,
    Hello,
    Load,
    Message,
    NodeStatus,
    NodeStatusState,
    Query,
    Rejected,
    Shutdown,
    Status,
    Unload,
)
from play_launch.wire.parameters import from_parameter_message, to_parameter_message

if TYPE_CHECKING:
    from collections.abc import Callable

_NANOSECONDS = 1_000_000_000


class MessageError(Exception):
    """A payload is not the message that its kind promises."""

    def __init__(self, kind: FrameKind, reason: object) -> None:
        super().__init__(f"the payload of a {kind.name} frame cannot be read: {reason}")
        self.kind = kind


class EncodeError(Exception):
    """A message cannot be put into a frame: a value does not fit, or it is too large."""

    def __init__(self, message: Message, reason: object) -> None:
        super().__init__(f"a {type(message).__name__} cannot be sent: {reason}")
        self.message = message


def preload() -> None:
    """Import what the conversions need.

    Raises:
        ImportError: When rclpy or play_launch_msgs is not there or does not load.
    """
    try:
        _ros()
    except ImportError:
        raise
    except Exception as error:  # rosidl's own type of error is none of ImportError
        raise ImportError(str(error)) from error


def encode_message(message: Message) -> bytes:
    """Make the frame of a message, in either direction.

    Raises:
        EncodeError: When a value is out of its field's range, or the whole does not fit a frame.
    """
    ros = _ros()
    kind = _KINDS[type(message)]
    try:
        ros_message = _ENCODERS[kind](ros, message)
        return encode_frame(kind, bytes(ros.serialize(ros_message)))
    except Exception as error:  # what rclpy raises differs with the field and with python -O
        raise EncodeError(message, error) from error


def decode_message(frame: Frame, *, container: str = "") -> Message | None:
    """Read the message in a frame of our own protocol version; None for an unknown kind.

    Args:
        frame: The frame.
        container: Full name of the container's node, which events carry.

    Raises:
        MessageError: When the payload is not what the kind promises.
    """
    try:
        kind = FrameKind(frame.kind)
    except ValueError:
        return None
    ros = _ros()
    try:
        ros_message = ros.deserialize(frame.payload, ros.types[kind])
        if kind is FrameKind.EVENT:
            return _decode_event(ros_message, container)
        return _DECODERS[kind](ros_message)
    except Exception as error:  # rclpy's own type of error is private
        raise MessageError(kind, error) from error


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
        self.msgs: Any = msgs
        self.types: dict[FrameKind, Any] = {
            FrameKind.HELLO: msgs.ControlHello,
            FrameKind.LOAD: msgs.ControlLoad,
            FrameKind.ACCEPTED: msgs.ControlAccepted,
            FrameKind.REJECTED: msgs.ControlRejected,
            FrameKind.EVENT: msgs.ComponentEvent,
            FrameKind.QUERY: msgs.ControlQuery,
            FrameKind.STATUS: msgs.ControlStatus,
            FrameKind.CANCEL: msgs.ControlCancel,
            FrameKind.UNLOAD: msgs.ControlUnload,
            FrameKind.SHUTDOWN: msgs.ControlShutdown,
        }
        for message_type in self.types.values():
            self.serialize(message_type())  # loads its type support

    def make(self, kind: FrameKind, message: object, *names: str) -> Any:
        """Make a message whose fields `names` are the attributes of the same names."""
        # Unchecked, numbers out of range are wrapped and wrong types crash.
        made = self.types[kind](check_fields=True)
        for name in names:
            value = getattr(message, name)
            setattr(made, name, list(value) if isinstance(value, tuple) else value)
        return made


@cache
def _ros() -> _Ros:
    return _Ros()


_KINDS: dict[type[Message], FrameKind] = {
    Hello: FrameKind.HELLO,
    Load: FrameKind.LOAD,
    Accepted: FrameKind.ACCEPTED,
    Rejected: FrameKind.REJECTED,
    ComponentEvent: FrameKind.EVENT,
    Query: FrameKind.QUERY,
    Status: FrameKind.STATUS,
    Cancel: FrameKind.CANCEL,
    Unload: FrameKind.UNLOAD,
    Shutdown: FrameKind.SHUTDOWN,
}
_HELLO_FIELDS = (
    "protocol_version",
    "version",
    "pid",
    "start_time",
    "full_node_name",
    "mode",
    "thread_num",
    "rmw_implementation",
    "domain_id",
    "mechanism",
)
_LOAD_FIELDS = (
    "attempt",
    "package_name",
    "plugin_name",
    "node_name",
    "node_namespace",
    "log_level",
)
_EVENT_FIELDS = (
    "unique_id",
    "attempt",
    "full_node_name",
    "package_name",
    "plugin_name",
    "error_message",
    "pid",
    "start_time",
    "exit_code",
    "signal",
    "confirmed_by",
)
_STATUS_FIELDS = (
    "query_id",
    "dropped_frames",
    "crashes",
    "undertaken",
    "leaked",
    "unquiesced",
)
_NODE_FIELDS = (
    "unique_id",
    "attempt",
    "full_node_name",
    "pid",
    "start_time",
    "elapsed_ns",
    "cpu_time_ns",
    "silence_ns",
    "note",
)


def _encode_load(ros: _Ros, load: Any) -> Any:
    made = ros.make(FrameKind.LOAD, load, *_LOAD_FIELDS, "remap_rules")
    made.parameters = [to_parameter_message(parameter) for parameter in load.parameters]
    made.extra_arguments = [to_parameter_message(argument) for argument in load.extra_arguments]
    return made


def _encode_event(ros: _Ros, event: Any) -> Any:
    made = ros.make(FrameKind.EVENT, event, *_EVENT_FIELDS, "backtrace")
    made.event_type = int(event.kind)
    made.stamp.sec, made.stamp.nanosec = divmod(event.stamp_ns, _NANOSECONDS)
    return made


def _encode_status(ros: _Ros, status: Any) -> Any:
    made = ros.make(FrameKind.STATUS, status, *_STATUS_FIELDS, "dead_locks")
    for node in status.nodes:
        item = ros.msgs.NodeStatus(check_fields=True)
        for name in _NODE_FIELDS:
            setattr(item, name, getattr(node, name))
        item.state = int(node.state)
        made.nodes.append(item)
    return made


def _copying(kind: FrameKind, *names: str) -> Callable[[_Ros, Any], Any]:
    return lambda ros, message: ros.make(kind, message, *names)


_ENCODERS: dict[FrameKind, Callable[[_Ros, Any], Any]] = {
    FrameKind.HELLO: _copying(FrameKind.HELLO, *_HELLO_FIELDS, "backends", "notes"),
    FrameKind.LOAD: _encode_load,
    FrameKind.ACCEPTED: _copying(FrameKind.ACCEPTED, "attempt", "unique_id"),
    FrameKind.REJECTED: _copying(FrameKind.REJECTED, "attempt", "unique_id", "reason"),
    FrameKind.EVENT: _encode_event,
    FrameKind.QUERY: _copying(FrameKind.QUERY, "query_id", "unique_ids"),
    FrameKind.STATUS: _encode_status,
    FrameKind.CANCEL: _copying(FrameKind.CANCEL, "unique_id"),
    FrameKind.UNLOAD: _copying(FrameKind.UNLOAD, "unique_id"),
    FrameKind.SHUTDOWN: _copying(FrameKind.SHUTDOWN, "reason"),
}


def _fields(message: Any, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: getattr(message, name) for name in names}


def _decode_event(message: Any, container: str) -> ComponentEvent:
    return ComponentEvent(
        stamp_ns=message.stamp.sec * _NANOSECONDS + message.stamp.nanosec,
        kind=ComponentEventKind(message.event_type),
        container=container,
        backtrace=tuple(message.backtrace),
        **_fields(message, _EVENT_FIELDS),
    )


def _decode_load(message: Any) -> Load:
    return Load(
        remap_rules=tuple(message.remap_rules),
        parameters=tuple(from_parameter_message(item) for item in message.parameters),
        extra_arguments=tuple(from_parameter_message(item) for item in message.extra_arguments),
        **_fields(message, _LOAD_FIELDS),
    )


def _decode_status(message: Any) -> Status:
    return Status(
        nodes=tuple(
            NodeStatus(state=NodeStatusState(node.state), **_fields(node, _NODE_FIELDS))
            for node in message.nodes
        ),
        dead_locks=tuple(message.dead_locks),
        **_fields(message, _STATUS_FIELDS),
    )


_DECODERS: dict[FrameKind, Callable[[Any], Message]] = {
    FrameKind.HELLO: lambda m: Hello(
        backends=tuple(m.backends), notes=tuple(m.notes), **_fields(m, _HELLO_FIELDS)
    ),
    FrameKind.LOAD: _decode_load,
    FrameKind.ACCEPTED: lambda m: Accepted(attempt=m.attempt, unique_id=m.unique_id),
    FrameKind.REJECTED: lambda m: Rejected(
        attempt=m.attempt, unique_id=m.unique_id, reason=m.reason
    ),
    FrameKind.QUERY: lambda m: Query(query_id=m.query_id, unique_ids=tuple(m.unique_ids)),
    FrameKind.STATUS: _decode_status,
    FrameKind.CANCEL: lambda m: Cancel(unique_id=m.unique_id),
    FrameKind.UNLOAD: lambda m: Unload(unique_id=m.unique_id),
    FrameKind.SHUTDOWN: lambda m: Shutdown(reason=m.reason),
}
