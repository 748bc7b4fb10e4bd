"""What is installed and how it is started: ROS, the container, the allocator."""
