"""Operating a running session from outside, over a socket in its folder.

Owns sessions, messages, the server and the client. `protocol`, `registration`, `sessions` and
`client` are what a command needs, and import next to nothing; the rest belongs to the supervisor.
"""
