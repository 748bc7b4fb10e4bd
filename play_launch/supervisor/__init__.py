"""What a system is meant to do and what it does, and every decision about it: pure.

Owns the world, its inputs, the effects and the events that follow. Knows no process, no socket,
no file and no clock: `play_launch.runtime` posts inputs and carries effects out.
"""
