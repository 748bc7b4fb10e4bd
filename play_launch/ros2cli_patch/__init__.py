"""Makes an installed ros2cli's own daemon bear a start-up storm, without changing its files.

``overlay`` is copied beside ros2cli and hooks in when Python imports the daemon; the other modules
here put it in place and take it away. Nothing of ros2cli's source is here or in what is written.
"""
