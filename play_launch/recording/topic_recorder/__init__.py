"""Records topics of ROS: starts the program `topic_recorder` and passes on what it makes.

Begin with :func:`.supervision.recorded_topics`. ``docs/decisions/topic-recorder.md`` has the
reasons for a program of its own.
"""
