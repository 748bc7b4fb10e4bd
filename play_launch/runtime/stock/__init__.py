"""Containers of others, driven by the composition services instead of the control channel."""
