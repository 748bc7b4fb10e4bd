"""ROS as a client: one pool of rclpy nodes by domain, and everything particular to Fast DDS.

Owns the clients of composition, lifecycle, parameters and the graph. Decides nothing, and knows no
state of the supervisor.
"""
