"""A drop-in for ros2cli's daemon: the same address and protocol, built to survive a start-up storm.

Importing this package imports nothing of ROS; only ``ros_graph``, which talks to rclpy, does.
"""
