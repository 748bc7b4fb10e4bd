"""A container's side of the codec: what it sends, and what it is sent.

Written field by field, so that the supervisor's codec is tested against the messages and not
against itself.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import play_launch_msgs.msg as msgs
from rclpy.serialization import deserialize_message, serialize_message

from play_launch.config.model import ParameterConfig, ParameterType, ParameterValue
from play_launch.container.codec import Frame, FrameKind, encode_frame
from play_launch.container.messages import (
    Accepted,
    Cancel,
    Hello,
    Incoming,
    Load,
    Outgoing,
    Query,
    Rejected,
    Shutdown,
    Status,
    Unload,
)
from play_launch.supervisor.events import ComponentEvent

Message: TypeAlias = Incoming | Outgoing


def frame_of(message: Incoming) -> bytes:
    """What a container sends."""
    match message:
        case Hello():
            kind, made = FrameKind.HELLO, msgs.ControlHello(**values(message))
        case Accepted():
            kind, made = FrameKind.ACCEPTED, msgs.ControlAccepted(**values(message))
        case Rejected():
            kind, made = FrameKind.REJECTED, msgs.ControlRejected(**values(message))
        case Status():
            nodes = [
                msgs.NodeStatus(**(values(node) | {"state": int(node.state)}))
                for node in message.nodes
            ]
            kind = FrameKind.STATUS
            made = msgs.ControlStatus(**(values(message) | {"nodes": nodes}))
        case ComponentEvent():
            given = values(message)
            for name in ("stamp_ns", "kind", "container", "received"):
                del given[name]
            kind = FrameKind.EVENT
            made = msgs.ComponentEvent(event_type=int(message.kind), **given)
            made.stamp.sec, made.stamp.nanosec = divmod(message.stamp_ns, 1_000_000_000)
    return encode_frame(kind, bytes(serialize_message(made)))


def outgoing(frame: Frame) -> Outgoing:
    """What a container is sent."""
    match FrameKind(frame.kind):
        case FrameKind.HELLO:
            hello = read(frame, msgs.ControlHello)
            return Hello(
                **hello | {"backends": tuple(hello["backends"]), "notes": tuple(hello["notes"])}
            )
        case FrameKind.LOAD:
            load = read(frame, msgs.ControlLoad)
            for name in ("parameters", "extra_arguments"):
                load[name] = tuple(from_parameter_message(each) for each in load[name])
            texts = {name: tuple(load[name]) for name in ("remap_rules", "resources")}
            return Load(**load | texts)
        case FrameKind.QUERY:
            query = read(frame, msgs.ControlQuery)
            return Query(query_id=query["query_id"], unique_ids=tuple(query["unique_ids"]))
        case FrameKind.CANCEL:
            return Cancel(**read(frame, msgs.ControlCancel))
        case FrameKind.UNLOAD:
            return Unload(**read(frame, msgs.ControlUnload))
        case FrameKind.SHUTDOWN:
            return Shutdown(**read(frame, msgs.ControlShutdown))
    raise AssertionError(f"a supervisor does not send kind {frame.kind}")


def values(message: Any) -> dict[str, Any]:
    found = {name: getattr(message, name) for name in type(message).__annotations__}
    return {name: [*value] if isinstance(value, tuple) else value for name, value in found.items()}


def read(frame: Frame, kind: Any) -> dict[str, Any]:
    message = deserialize_message(frame.payload, kind)
    return {name: getattr(message, name) for name in kind.get_fields_and_field_types()}


_FIELDS = {
    ParameterType.BOOL: "bool_value",
    ParameterType.INTEGER: "integer_value",
    ParameterType.DOUBLE: "double_value",
    ParameterType.STRING: "string_value",
    ParameterType.BYTE_ARRAY: "byte_array_value",
    ParameterType.BOOL_ARRAY: "bool_array_value",
    ParameterType.INTEGER_ARRAY: "integer_array_value",
    ParameterType.DOUBLE_ARRAY: "double_array_value",
    ParameterType.STRING_ARRAY: "string_array_value",
}


def from_parameter_message(message: Any) -> ParameterConfig:
    """Read a `rcl_interfaces/msg/Parameter`."""
    kind = ParameterType(message.value.type)
    value: Any = getattr(message.value, _FIELDS[kind])
    if kind is ParameterType.BYTE_ARRAY:
        value = b"".join(value)
    elif kind.name.endswith("_ARRAY"):
        value = tuple(value)
    return ParameterConfig(message.name, ParameterValue(kind, value))
