"""A drop-in replacement of ros2cli's daemon that survives a start-up storm, and a patch for that.

Owns address, protocol and life of the daemon. Importing this package imports nothing of ROS; only
``ros_graph``, which calls rclpy, does. Knows no configuration of a system.
"""
