"""ROS as a client sees it: one rclpy thread, and what it reports to the event loop."""
