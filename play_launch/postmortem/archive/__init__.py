"""Earlier sessions in the log folder: recovered when they were cut off, removed when asked.

It is a program of its own, ``python -m play_launch.postmortem.archive``, that ``replay`` starts at
the lowest priority when the system is up. Decisions are pure; what is done survives being killed.
"""
