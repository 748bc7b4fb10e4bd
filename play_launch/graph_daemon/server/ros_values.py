"""From rclpy's objects to what `marshal` writes.

Needs no rclpy: an object says by its class what it is. That also fits Humble, whose classes have
fewer members.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Final

from play_launch.graph_daemon.server.marshal import Tagged, TaggedStruct

_DURATION: Final = "rclpy.duration.Duration"
_STRUCTS: Final = frozenset(
    {
        "rclpy.qos.QoSProfile",
        "rclpy.topic_endpoint_info.TopicEndpointInfo",
        "rclpy.type_hash.TypeHash",
    }
)
_ENUMERATIONS: Final = frozenset(
    {
        "rclpy.qos.HistoryPolicy",
        "rclpy.qos.ReliabilityPolicy",
        "rclpy.qos.DurabilityPolicy",
        "rclpy.qos.LivelinessPolicy",
        "rclpy.topic_endpoint_info.TopicEndpointTypeEnum",
    }
)


def to_wire(value: object) -> object:
    """Return ``value`` with every known object of rclpy replaced; others stay as they are."""
    if isinstance(value, str | bytes):
        return value
    if isinstance(value, Sequence):
        return [to_wire(element) for element in value]
    if isinstance(value, Mapping):
        return {name: to_wire(member) for name, member in value.items()}
    kind = type(value)
    tag = f"{kind.__module__}.{kind.__name__}"
    if tag == _DURATION:
        return Tagged(tag, str(value.nanoseconds))  # type: ignore[attr-defined]
    if isinstance(value, Enum) and tag in _ENUMERATIONS:
        return Tagged(tag, str(value.value))
    if tag in _STRUCTS:
        # The slots give order and names of the members; their properties give the values.
        names = [slot.lstrip("_") for slot in kind.__slots__]  # type: ignore[attr-defined]
        return TaggedStruct(tag, {name: to_wire(getattr(value, name)) for name in names})
    return value
