"""How the shared memory of the dead is removed where nobody of ours lives to do it."""

from __future__ import annotations

import sys


def sweep_command() -> list[str]:
    """Give the command; it runs for a moment, in the environment of the supervisor."""
    # -P: the working directory is anybody's.
    return [sys.executable, "-P", "-m", "play_launch.ros.fastdds"]
