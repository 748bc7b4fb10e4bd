"""Recordings, read back; damaged ones as far as they can be read."""
