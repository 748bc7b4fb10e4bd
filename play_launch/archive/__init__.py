"""The sessions of before, in the log folder: recovered when they were cut off, removed when asked.

It is a program of its own, ``python -m play_launch.archive``, that ``replay`` starts at the lowest
priority when the system is up. What is decided here is pure; what is done survives being killed.
"""
