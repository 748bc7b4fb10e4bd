#!/usr/bin/env python3
"""A range finder that is not there, and that fails at times, as drivers do."""

import math

import rclpy
from rclpy.node import Node
from std_msgs.msg import Float64


class Driver(Node):
    """Publishes distances in m on `range`, 20 a second."""

    def __init__(self) -> None:
        super().__init__("driver")
        self.fails_after = self.declare_parameter("fails_after", 0).value
        self.publisher = self.create_publisher(Float64, "range", 10)
        self.create_timer(0.05, self.measure)
        self.count = 0

    def measure(self) -> None:
        self.count += 1
        if self.count == self.fails_after:
            raise OSError("the range finder does not answer")
        self.publisher.publish(Float64(data=2.0 + math.sin(self.count / 20)))


rclpy.init()
try:
    rclpy.spin(Driver())
except KeyboardInterrupt:
    pass
