#!/usr/bin/env python3
"""A managed (lifecycle) node: the nearer an obstacle is, the slower it drives."""

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from std_msgs.msg import Float64


class Planner(LifecycleNode):
    """Publishes a speed in m/s on `speed` for each distance on `range/filtered`."""

    def __init__(self) -> None:
        super().__init__("planner")

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.fastest = self.declare_parameter("fastest", 1.0).value
        self.publisher = self.create_lifecycle_publisher(Float64, "speed", 10)
        self.create_subscription(Float64, "range/filtered", self.plan, 10)
        return super().on_configure(state)

    def plan(self, distance: Float64) -> None:
        if self.publisher.is_activated:
            self.publisher.publish(Float64(data=min(self.fastest, distance.data / 2)))


rclpy.init()
try:
    rclpy.spin(Planner())
except (KeyboardInterrupt, ExternalShutdownException):
    pass
