"""Announces nodes of a participant that does not exist, until its standard input ends.

    python -m tests.graph_daemon.ghost NAME...

They have no endpoints. rclpy cannot write to the topic of these announcements, as it puts a slash
before each name; so rmw is called by its own functions.
"""

from __future__ import annotations

import ctypes
import os
import sys
from typing import Any

from rclpy.serialization import serialize_message
from rmw_dds_common.msg import (  # type: ignore[import-untyped]
    Gid,
    NodeEntitiesInfo,
    ParticipantEntitiesInfo,
)

from tests.support.ros import Probe
from tests.support.waiting import until


class Duration(ctypes.Structure):
    _fields_ = (("sec", ctypes.c_uint64), ("nsec", ctypes.c_uint64))


class Qos(ctypes.Structure):
    """`rmw_qos_profile_t`."""

    _fields_ = (
        ("history", ctypes.c_int),
        ("depth", ctypes.c_size_t),
        ("reliability", ctypes.c_int),
        ("durability", ctypes.c_int),
        ("deadline", Duration),
        ("lifespan", Duration),
        ("liveliness", ctypes.c_int),
        ("lease", Duration),
        ("avoids_ros_conventions", ctypes.c_bool),
    )


class Options(ctypes.Structure):
    """`rmw_publisher_options_t`."""

    _fields_ = (("payload", ctypes.c_void_p), ("unique", ctypes.c_int))


class Bytes(ctypes.Structure):
    """`rmw_serialized_message_t`."""

    _fields_ = (
        ("buffer", ctypes.c_char_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", ctypes.c_void_p * 5),
    )


def function(library: str, name: str, result: Any, *arguments: Any) -> Any:
    found = getattr(ctypes.CDLL(library), name)
    found.restype, found.argtypes = result, arguments
    return found


def main(names: list[str]) -> None:
    pointer, rmw = ctypes.c_void_p, "librmw_fastrtps_cpp.so"
    with Probe("announcer") as probe, probe.node.handle:
        node = function("librcl.so", "rcl_node_get_rmw_handle", pointer, pointer)(
            probe.node.handle.pointer
        )
        type_of = "rosidl_typesupport_c__get_message_type_support_handle__rmw_dds_common__msg__"
        library = "librmw_dds_common__rosidl_typesupport_c.so"
        message_type = function(library, f"{type_of}ParticipantEntitiesInfo", pointer)()
        options = function(rmw, "rmw_get_default_publisher_options", Options)()
        # Keep last, reliable, transient local, automatic.
        qos = Qos(1, 1, 1, 1, liveliness=1, avoids_ros_conventions=True)
        arguments = (pointer, pointer, ctypes.c_char_p, pointer, pointer)
        publisher = function(rmw, "rmw_create_publisher", pointer, *arguments)(
            node, message_type, b"ros_discovery_info", ctypes.byref(qos), ctypes.byref(options)
        )
        assert publisher
        info = ParticipantEntitiesInfo(
            gid=Gid(data=list(os.urandom(16))),
            node_entities_info_seq=[
                NodeEntitiesInfo(node_namespace="/", node_name=name) for name in names
            ],
        )
        data = serialize_message(info)
        count = ctypes.c_size_t()
        matched = function(
            rmw, "rmw_publisher_count_matched_subscriptions", ctypes.c_int, pointer, pointer
        )
        until(
            lambda: matched(publisher, ctypes.byref(count)) == 0 and count.value >= 2,
            "the readers of this participant and of the daemon's",
        )
        publish = function(
            rmw, "rmw_publish_serialized_message", ctypes.c_int, pointer, pointer, pointer
        )
        text = Bytes(data, len(data), len(data))
        assert publish(publisher, ctypes.byref(text), None) == 0
        sys.stdin.read()


if __name__ == "__main__":
    main(sys.argv[1:])
