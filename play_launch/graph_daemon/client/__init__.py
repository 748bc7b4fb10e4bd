"""Asks a graph daemon, ours or ros2cli's, without anything of ROS."""
