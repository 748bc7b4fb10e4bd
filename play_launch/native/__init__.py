"""The native container: where it is, how it is started and how one talks to it."""
