"""Operating a running session from outside: a socket in its folder, and who talks over it.

`protocol`, `place` and `client` are what a command needs and import next to nothing; the rest
belongs to the supervisor.
"""
