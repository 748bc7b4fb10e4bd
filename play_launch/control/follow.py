"""Streams events to one client, which may read slowly or never."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING, Final

from play_launch.supervisor.event_object import event_object
from play_launch.supervisor.events import LogRecord, OutputLine

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.control.connection import Stream
    from play_launch.control.selection import Selection
    from play_launch.supervisor.events import RunEvent

MOST_WAITING: Final = 5000
"""Events that wait for one client; further ones are dropped for it, and counted."""
MOST_TEXT: Final = 1024 * 1024
"""Characters of output among them."""
_AT_ONCE: Final = 100
"""Events after which others get their turn."""


class Follower:
    """The events that wait for one client."""

    def __init__(self, selection: Selection) -> None:
        """Take those that are selected."""
        self._selection = selection
        self._waiting: deque[RunEvent] = deque()
        self._text = 0
        self._missed = 0
        self._is_filled = asyncio.Event()

    def take(self, event: RunEvent) -> None:
        """See an event, without waiting."""
        if not self._selection.wants(event):
            return
        size = _size(event)
        if len(self._waiting) >= MOST_WAITING or self._text + size > MOST_TEXT:
            self._missed += 1
        else:
            self._waiting.append(event)
            self._text += size
        self._is_filled.set()

    async def send_all(self, events: Iterable[RunEvent], stream: Stream) -> None:
        """Send these, as far as they are selected, whatever time it takes."""
        for number, event in enumerate(filter(self._selection.wants, events)):
            await stream.send("event", event_object(event))
            if number % _AT_ONCE == 0:
                await asyncio.sleep(0)

    async def follow(self, stream: Stream) -> None:
        """Send what it takes until this is cancelled."""
        while True:
            await self._is_filled.wait()
            for _ in range(_AT_ONCE):
                if not self._waiting:
                    break
                event = self._waiting.popleft()
                self._text -= _size(event)
                await stream.send("event", event_object(event))
            if self._missed and not self._waiting:
                missed, self._missed = self._missed, 0
                await stream.send("missed", missed)
            if not self._waiting and not self._missed:
                self._is_filled.clear()
            await asyncio.sleep(0)


def _size(event: RunEvent) -> int:
    if isinstance(event, OutputLine):
        return len(event.text)
    return len(event.message) if isinstance(event, LogRecord) else 0
