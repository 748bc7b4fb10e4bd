"""How a run is told to end."""

from __future__ import annotations

import asyncio


class StopRequests:
    """The first request stops the system in order, every further one hurries that.

    Belongs to the thread of the event loop: hand signals over with ``loop.call_soon_threadsafe``.
    """

    def __init__(self) -> None:
        self.requested = asyncio.Event()
        self.hurry = asyncio.Event()
        self.signum: int | None = None
        """The signal of the first request; None where it was none."""
        self.reason = ""

    def request(self, signum: int | None = None, reason: str = "") -> None:
        """Ask for the end, or for more haste."""
        if self.requested.is_set():
            self.hurry.set()
            return
        self.signum = signum
        self.reason = reason or (f"signal {signum}" if signum is not None else "requested")
        self.requested.set()
