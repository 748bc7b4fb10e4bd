"""The flight recorder: events and topics of a run in MCAP files that ROS tools can open.

Begin with :func:`play_launch.recording.session.open_session`; ``docs/recording.md`` describes the
layout of the files. Does not know the readers.
"""
