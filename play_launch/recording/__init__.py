"""The flight recorder: every event of a run into one MCAP file that ROS tools can open.

Start with :func:`play_launch.recording.session.open_session`; the file's layout is described in
``docs/recording.md``.
"""
