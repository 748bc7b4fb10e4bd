"""ROS launch files and other tools' descriptions, evaluated into configurations.

Does not know how a configuration is run.
"""
