"""When a member may start: its conditions hold, and a place among those that start is free."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Awaitable, Callable


class StartTurn:
    """The turn of one member; it is taken, and given back when its process is up, or has ended."""

    def __init__(
        self,
        slots: asyncio.Semaphore | None = None,
        conditions: Callable[[], Awaitable[str]] | None = None,
    ) -> None:
        """Take what bounds how many start at a time, and what waits for the conditions.

        ``conditions`` returns why they will not hold, or nothing when they do.
        """
        self._slots = slots
        self._conditions = conditions
        self._has_slot = False

    async def take(self) -> str:
        """Wait for it; says why it does not come, or nothing when it is there."""
        if self._conditions is not None and (why := await self._conditions()):
            return why
        if self._slots is not None:
            await self._slots.acquire()
            self._has_slot = True
        return ""

    def give_back(self) -> None:
        """Let another one start; harmless when it was not taken."""
        if self._has_slot and self._slots is not None:
            self._has_slot = False
            self._slots.release()
