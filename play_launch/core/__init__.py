"""Pure decisions: what happened, what state follows and what to do about it.

Nothing here does I/O or reads a clock; time and random numbers are passed in.
"""
