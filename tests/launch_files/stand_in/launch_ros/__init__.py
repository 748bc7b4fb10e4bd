"""A stand-in for launch_ros: its names, without nodes."""
