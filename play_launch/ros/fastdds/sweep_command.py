"""Command that removes the shared memory of dead processes after the supervisor's exit."""

from __future__ import annotations

import sys


def sweep_command() -> list[str]:
    """Give the command; it runs for a moment, in the environment of the supervisor."""
    # -P: the working directory is not trusted.
    return [sys.executable, "-P", "-m", "play_launch.ros.fastdds"]
