"""Records topics of ROS: starts the program `topic_recorder` and passes on what it makes.

Begin with :func:`play_launch.topic_recording.supervision.recorded_topics`. Why this is a program of
its own is in ``docs/decisions/topic-recorder.md``.
"""
