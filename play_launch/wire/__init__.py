"""The control channel to a container: frames, messages and the types on it."""
