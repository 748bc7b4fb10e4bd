"""A small system to ask about, as a program: ``python -m tests.graph_daemon.scene``.

It says "up" when it stands and lives until its standard input ends.
"""

from __future__ import annotations

import sys

import rclpy
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
from std_msgs.msg import String
from std_srvs.srv import Trigger

NODES = (("talker", "/"), ("listener", "/"), ("camera", "/sensing"), ("twin", "/"))
TOPICS = ("/chatter", "/sensing/image")
SERVICE = "/sensing/camera/reset"


def main() -> None:
    rclpy.init()
    talker = rclpy.create_node("talker")
    talker.create_publisher(String, "chatter", 10)
    camera = rclpy.create_node("camera", namespace="/sensing")
    camera.create_publisher(
        Image,
        "image",
        QoSProfile(
            depth=5,
            reliability=ReliabilityPolicy.BEST_EFFORT,
            deadline=Duration(nanoseconds=100_000_001),
            lifespan=Duration(seconds=1),
            liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
            liveliness_lease_duration=Duration(seconds=20),
        ),
    )
    camera.create_service(Trigger, "~/reset", lambda _request, response: response)
    listener = rclpy.create_node("listener", start_parameter_services=False)
    listener.create_subscription(
        String,
        "chatter",
        lambda _: None,
        QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    )
    listener.create_client(Trigger, SERVICE)
    twins = [rclpy.create_node("twin", start_parameter_services=False) for _ in range(2)]
    print("up", flush=True)
    sys.stdin.read()
    for node in (talker, camera, listener, *twins):
        node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
