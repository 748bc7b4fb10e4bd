"""An evaluator of our own for launch files in XML and YAML, with the semantics of ROS's launch.

It follows launch 3.4 and launch_ros 0.26 (ROS 2 Jazzy), also where those surprise: an include does
not scope, `$(dirname)` after an include is the folder of the included file, and a global parameter
that is set in a group stays if there was one before.
"""
