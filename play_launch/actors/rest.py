"""Whether a member is at rest, for those who wait for that."""

from __future__ import annotations

import asyncio

from play_launch.actors.first_of import first_of


class Rest:
    """Belongs to the event loop's thread; a member is at rest at first."""

    def __init__(self) -> None:
        self._reached = asyncio.Event()
        self._reached.set()
        self._recalled = asyncio.Event()

    @property
    def is_reached(self) -> bool:
        """Whether it does not run, nothing is left of it, and it does not start by itself."""
        return self._reached.is_set()

    def note(self, *, is_reached: bool, is_wanted: bool) -> None:
        """Take how it is now."""
        (self._reached.set if is_reached else self._reached.clear)()
        (self._recalled.set if is_wanted else self._recalled.clear)()

    async def wait(self) -> None:
        """Wait until it is at rest."""
        await self._reached.wait()

    async def wait_unless_recalled(self) -> bool:
        """Wait until it is at rest; False when somebody wants it to run again before that."""
        await first_of(self._reached.wait(), self._recalled.wait())
        return self.is_reached
