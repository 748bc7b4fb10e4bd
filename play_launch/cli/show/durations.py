"""Times for people."""

from __future__ import annotations

from typing import Final

_SECOND: Final = 1_000_000_000


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
