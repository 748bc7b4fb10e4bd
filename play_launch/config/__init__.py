"""The configuration file: read, include, check and resolve it into an immutable model.

Owns every key with its type, default and description. Knows no process and no ROS.
"""
