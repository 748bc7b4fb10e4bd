"""ROS as a client sees it: one rclpy thread, and what it tells the event loop."""
