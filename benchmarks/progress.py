"""Progress of a long measurement."""

from __future__ import annotations

import sys
import time

_EVERY, _EVERY_IN_A_FILE = 2.0, 30.0
"""Seconds."""


class Progress:
    """Lines on stderr, not too many."""

    def __init__(self) -> None:
        self._begin = time.monotonic()
        self._every = _EVERY if sys.stderr.isatty() else _EVERY_IN_A_FILE
        self._last = -self._every

    @property
    def seconds(self) -> float:
        """Since it was made."""
        return time.monotonic() - self._begin

    def tell(self, text: str, *, force: bool = False) -> None:
        """Say it, unless something was said just before."""
        seconds = self.seconds
        if force or seconds - self._last >= self._every:
            self._last = seconds
            print(f"  {text}, {seconds:.0f} s", file=sys.stderr, flush=True)
