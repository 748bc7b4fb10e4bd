"""The exit status of a process, where that needs more than a number."""

from typing import Final

UNKNOWN_STATUS: Final = -1
"""Stands for one that nobody knows: who could have read it was killed, or somebody else did."""
