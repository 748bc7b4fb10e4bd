"""Times for people."""

from __future__ import annotations

import re
import time
from typing import Final

_SECOND: Final = 1_000_000_000
_CLOCK: Final = re.compile(r"([01]?\d|2[0-3]):([0-5]\d)(?::([0-5]\d(?:\.\d+)?))?")


def duration(nanoseconds: int) -> str:
    """Write a time for people: ``0.8 s``, ``12 s``, ``3 min 20 s``, ``2 h 5 min``."""
    seconds = nanoseconds / _SECOND
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole // 60 % 60} min"


def clock_times(text: str, near: float) -> list[float]:
    """List when the clock shows ``14:03`` or ``14:03:07``: the day before, that day, the next.

    Args:
        text: What was typed; there are none when it is something else.
        near: A time of that day; it and the result are seconds since the epoch.
    """
    clock = _CLOCK.fullmatch(text)
    if clock is None:
        return []
    year, month, day = time.localtime(near)[:3]
    hour, minute, seconds = int(clock[1]), int(clock[2]), float(clock[3] or 0)
    return [
        time.mktime((year, month, day + days, hour, minute, 0, 0, 0, -1)) + seconds
        for days in (-1, 0, 1)
    ]
