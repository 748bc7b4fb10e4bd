"""How a run is asked to end."""

from __future__ import annotations

import asyncio


class StopRequests:
    """The first request stops the system in order; the second signal hurries that.

    Several crashes of one moment may each ask for the end, and so may a crash and a signal: that
    is nobody's impatience.

    Belongs to the thread of the event loop: hand signals over with ``loop.call_soon_threadsafe``.
    """

    def __init__(self) -> None:
        self.requested = asyncio.Event()
        self.hurry = asyncio.Event()
        self.signum: int | None = None
        """The signal of the first request; None where it was none."""
        self.reason = ""
        self._signals = 0

    def request(self, signum: int | None = None, reason: str = "") -> None:
        """Ask for the end, or with a second signal for more haste."""
        self._signals += signum is not None
        if self.requested.is_set():
            if self._signals > 1:
                self.hurry.set()
            return
        self.signum = signum
        self.reason = reason or (f"signal {signum}" if signum is not None else "requested")
        self.requested.set()
