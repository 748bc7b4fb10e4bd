"""How restless the graph is: when the first answer may be given, and whether it has settled."""

from __future__ import annotations

from collections import deque
from typing import Final

QUIET: Final = 0.5
"""Seconds without a change after which the graph counts as settled."""
LONGEST_WARM_UP: Final = 5.0
"""Seconds after which answers are given in any case; a storm may last for minutes."""
WINDOW: Final = 10.0
"""Seconds over which changes are counted."""
LOOK_AGAIN: Final = 0.1
"""Seconds until a graph that is quiet, but not complete, is looked at again."""


class Pulse:
    """Folds the times of changes; all times are seconds of one clock that never jumps.

    A node that has just joined knows nobody yet, so its first answers would be empty lists. It is
    warm when discovery has paused for `QUIET` and nobody is known to be missing, or when
    `LONGEST_WARM_UP` is over.
    """

    def __init__(self, started: float) -> None:
        self._started = started
        self._last = started
        self._changes: deque[float] = deque()

    @property
    def deadline(self) -> float:
        """When it is warm in any case."""
        return self._started + LONGEST_WARM_UP

    def change(self, now: float) -> None:
        """The graph changed."""
        self._last = max(self._last, now)
        self._changes.append(now)
        self._forget(now)

    def is_warm(self, now: float, *, complete: bool) -> bool:
        """Whether answers may be given; ``complete`` says that nobody is known to be missing."""
        return now >= self.deadline or (complete and self.is_quiet(now))

    def look_again_at(self, now: float) -> float:
        """Return when it may be warm next; later than ``now``."""
        return min(max(self._last + QUIET, now + LOOK_AGAIN), max(self.deadline, now + LOOK_AGAIN))

    def is_quiet(self, now: float) -> bool:
        """Whether nothing has changed for a while."""
        return now - self._last >= QUIET

    def quiet_for(self, now: float) -> float:
        """Return the seconds since the last change."""
        return max(0.0, now - self._last)

    def rate(self, now: float) -> float:
        """Return the changes per second, over the last `WINDOW` or since the start."""
        self._forget(now)
        return len(self._changes) / max(1.0, min(WINDOW, now - self._started))

    def _forget(self, now: float) -> None:
        while self._changes and self._changes[0] <= now - WINDOW:
            self._changes.popleft()
