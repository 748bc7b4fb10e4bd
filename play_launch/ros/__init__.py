"""ROS as a client sees it: rclpy in threads of its own, and what is particular to Fast DDS.

Decides nothing.
"""
