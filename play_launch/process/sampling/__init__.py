"""What the processes of a system use, and what the machine does meanwhile, as events.

`docs/decisions/sampling.md` says what is read, how often, and at which cost.
"""
