"""How long a container may take for what."""

from __future__ import annotations

import os
from typing import Final

from msgspec import Struct

from play_launch.core.watchdog import WATCH_LIMITS, WatchLimits


class Limits(Struct, frozen=True, kw_only=True):
    """Seconds."""

    hello: float = 30.0
    """From the start of a container to its hello."""
    last_words: float = 0.5
    """From its end to the end of what it said on the control channel."""
    exit_after_close: float = 2.0
    """From its closing the control channel to its end."""
    report_interval: float = 15.0
    """Between two reports of a slow constructor."""
    reload_after_leak: float = 3.0
    """For a reload beyond its usual time, when a dead node probably left a lock locked."""
    silence: float = 10.0
    """For a callback, before it is reported as blocking the executor."""
    watch: WatchLimits = WATCH_LIMITS
    """From when on a silent container counts as frozen."""


LIMITS: Final = Limits()


def default_starts() -> int:
    """How many containers start up at the same time.

    Enough for all of most systems: see docs/decisions/start.md. Hundreds would outlast the limits
    that each has for its start.
    """
    return max(16, 4 * (os.cpu_count() or 1))
