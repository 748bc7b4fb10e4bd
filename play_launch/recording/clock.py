"""The clock of a session: its log times go on evenly, whatever is done to the system clock."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

CLOCK_METADATA: Final = "play_launch.clock"
"""Metadata record after each jump: ``ahead_ns``, by which the system clock is ahead since then."""
_JUMP_NS: Final = 100_000_000
"""A smaller difference is not noticed."""
_READINGS: Final = 5


_boot_time_ns: Final = partial(time.clock_gettime_ns, time.CLOCK_BOOTTIME)
"""Nanoseconds since the machine booted; they count while it is suspended, too."""


class SessionClock:
    """The system clock at the start of the session, plus the time since then. In any thread."""

    def __init__(
        self, wall: Callable[[], int] = time.time_ns, steady: Callable[[], int] = _boot_time_ns
    ) -> None:
        self._wall = wall
        self._steady = steady
        readings = ((steady(), wall(), steady()) for _ in range(_READINGS))
        # Where the processor was taken away in between, log times would be off by as much.
        before, now, after = min(readings, key=lambda each: each[2] - each[0])
        self.offset_ns = now - (before + after) // 2
        """What is added to the time since boot; `topic_recorder` does the same."""
        self.ahead_ns = 0
        """By how much the system clock is ahead, since its last jump."""

    def now(self) -> int:
        return self.offset_ns + self._steady()

    def jump_ns(self) -> int:
        """Return by how much the system clock was set since the last call; 0: not noticeably."""
        before = self.now()
        wall = self._wall()
        if self.now() - before > _JUMP_NS // 2:
            return 0  # this thread had no processor in between; the next call finds out
        jump = wall - before - self.ahead_ns
        if abs(jump) < _JUMP_NS:
            return 0
        self.ahead_ns += jump
        return jump
