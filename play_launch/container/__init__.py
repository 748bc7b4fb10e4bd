"""The native programs: where they and ROS are installed, and how to talk to a container.

Owns command lines, environments, the control channel with its frames and messages, and CDR. Does
not know what follows from a message.
"""
