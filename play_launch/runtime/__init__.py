"""Runs a system: posts inputs to the supervisor and carries its effects out.

Owns the loop, the actors of processes and containers, the sources of inputs and the way of events
to their sinks. Decides nothing: that is `play_launch.supervisor`.
"""
