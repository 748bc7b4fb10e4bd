"""Evaluates launch files by ROS's own `launch` and `launch_ros`, in a process of its own.

`evaluate` is for the program; everything else runs in that process. It visits the description as
`launch.LaunchService` does, and replaces only the ends: nothing is started, what would be started
becomes a record.
"""
