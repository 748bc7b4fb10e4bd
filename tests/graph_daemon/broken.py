"""A system in which little connects, as a program: ``python -m tests.graph_daemon.broken``.

It says "up" when it stands and lives until its standard input ends.
"""

from __future__ import annotations

import sys

import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Int32, String
from std_srvs.srv import Trigger

PAIRS = {
    "reliability": (
        QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT),
        QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE),
    ),
    "durability": (
        QoSProfile(depth=1, durability=DurabilityPolicy.VOLATILE),
        QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    ),
    "deadline": (
        QoSProfile(depth=1, deadline=Duration(seconds=2)),
        QoSProfile(depth=1, deadline=Duration(seconds=1)),
    ),
    "liveliness": (
        QoSProfile(depth=1, liveliness=LivelinessPolicy.AUTOMATIC),
        QoSProfile(depth=1, liveliness=LivelinessPolicy.MANUAL_BY_TOPIC),
    ),
    "lease_duration": (
        QoSProfile(depth=1, liveliness_lease_duration=Duration(seconds=20)),
        QoSProfile(depth=1, liveliness_lease_duration=Duration(seconds=10)),
    ),
}
"""What is offered and requested on the topic ``/qos/NAME``."""


def new(name: str) -> Node:
    """Make a node with a participant of its own, which allows one type a topic only."""
    context = Context()
    rclpy.init(context=context)
    return rclpy.create_node(name, context=context, start_parameter_services=False)


def main() -> None:
    source, sink = new("source"), new("sink")
    nodes = [source, sink, new("twin"), new("twin")]
    for policy, (offered, requested) in PAIRS.items():
        source.create_publisher(String, f"/qos/{policy}", offered)
        sink.create_subscription(String, f"/qos/{policy}", lambda _: None, requested)
    source.create_publisher(String, "/two/types", 1)
    sink.create_subscription(Int32, "/two/types", lambda _: None, 1)
    source.create_publisher(String, "/lidar/points", 1)
    sink.create_subscription(String, "/points", lambda _: None, 1)  # a namespace is missing
    source.create_publisher(String, "/camera/image", 1)
    sink.create_subscription(String, "/camera/imgae", lambda _: None, 1)  # misspelled
    sink.create_subscription(Int32, "/odometer", lambda _: None, 1)
    source.create_publisher(Int32, "/debug/count", 1)
    source.create_publisher(String, "/fine", 1)
    sink.create_subscription(String, "/fine", lambda _: None, 1)
    sink.create_client(Trigger, "/map/load")
    print("up", flush=True)
    sys.stdin.read()
    for node in nodes:
        node.destroy_node()
        node.context.shutdown()


if __name__ == "__main__":
    main()
