"""ROS messages as bytes (CDR, version 1), without ROS."""
