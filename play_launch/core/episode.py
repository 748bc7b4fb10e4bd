"""Reporting a number that grows in bursts: at once when it begins, and once when it is over."""

from __future__ import annotations

from msgspec import Struct

QUIET = 10.0
"""Seconds without growth after which a burst counts as over."""


class Episode(Struct):
    """One number that only grows. Times are seconds of any monotonic clock and are passed in."""

    quiet: float = QUIET
    count: int = 0
    _reported: int = 0
    _grew_at: float | None = None
    """Of the burst that goes on; None without one."""

    def see(self, count: int, now: float) -> bool:
        """Take the number as it is now; return whether it is to be reported."""
        if count > self.count:
            self.count = count
            began = self._grew_at is None
            self._grew_at = now
            return began and self._report()
        if self._grew_at is not None and now - self._grew_at >= self.quiet:
            self._grew_at = None
            return self.count > self._reported and self._report()
        return False

    def _report(self) -> bool:
        self._reported = self.count
        return True
