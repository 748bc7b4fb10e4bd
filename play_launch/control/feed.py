"""What has happened lately, and whoever follows what happens."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from typing import TYPE_CHECKING, Final

from play_launch.supervisor.events import LogRecord, OutputLine, RunEvent, Sample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from play_launch.supervisor.view import SystemView

MOST_EVENTS: Final = 2000
"""Events other than output that are kept; the recording has all."""
MOST_LINES: Final = 300
"""Lines of output that are kept of each process."""
MOST_TEXT: Final = 64 * 1024
"""Characters of these lines."""


class Feed:
    """Sees all events of a run from its start. It belongs to the thread of the event loop."""

    def __init__(self) -> None:
        self._events: deque[RunEvent] = deque(maxlen=MOST_EVENTS)
        self._lines: dict[str, _Lines] = {}
        self._followers: list[Callable[[RunEvent], None]] = []
        self._loop: asyncio.AbstractEventLoop | None = None

    def begin(self) -> None:
        """Know the loop: records of the log come from any thread."""
        self._loop = asyncio.get_running_loop()

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:  # noqa: ARG002 - a sink
        """See an event."""
        self._take(event)

    def publish_log(self, event: LogRecord) -> None:
        """See a record of the log, in any thread."""
        if self._loop is None:
            self._events.append(event)
            return
        with contextlib.suppress(RuntimeError):  # the loop has ended, and so have all who follow
            self._loop.call_soon_threadsafe(self._take, event)

    def recent(self) -> list[RunEvent]:
        """What is kept, in the order of time."""
        lines = (line for each in self._lines.values() for line in each.lines)
        return sorted([*self._events, *lines], key=lambda event: event.stamp_ns)

    @contextlib.contextmanager
    def followed_by(self, follower: Callable[[RunEvent], None]) -> Iterator[None]:
        """Hand every event to somebody while the block runs, samples included."""
        self._followers.append(follower)
        try:
            yield
        finally:
            self._followers.remove(follower)

    def _take(self, event: RunEvent) -> None:
        if isinstance(event, OutputLine):
            lines = self._lines.get(event.process)
            if lines is None:
                lines = self._lines[event.process] = _Lines()
            lines.append(event)
        elif not isinstance(event, Sample):
            self._events.append(event)
        for follower in self._followers:
            follower(event)


class _Lines:
    """The last lines of one process."""

    def __init__(self) -> None:
        self.lines: deque[OutputLine] = deque()
        self._text = 0

    def append(self, line: OutputLine) -> None:
        self.lines.append(line)
        self._text += len(line.text)
        while len(self.lines) > MOST_LINES or (self._text > MOST_TEXT and len(self.lines) > 1):
            self._text -= len(self.lines.popleft().text)
