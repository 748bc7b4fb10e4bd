"""Recent events of a run, and the clients that follow them."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.config.node_key import NodeKey
from play_launch.control.event_words import EVENT_TYPES, event_object, names_of, words_of
from play_launch.recording.console_format import logger_of, loggers_in
from play_launch.supervisor.events import LogRecord, OutputLine, RunEvent, Sample

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence

    from play_launch.supervisor.view import SystemView

    Send = Callable[[str, object], Awaitable[None]]

KINDS: Final = frozenset(EVENT_TYPES.values())
USUAL_KINDS: Final = KINDS - {"output", "process_sample", "group_sample", "system_sample"}
EVENTS_LIMIT: Final = 2000
"""Events other than output that are kept; the recording has all."""
LINES_LIMIT: Final = 300
"""Lines of output that are kept of each process."""
TEXT_LIMIT: Final = 64 * 1024
"""Characters of these lines."""
QUEUE_LIMIT: Final = 5000
"""Events that wait for one client; further ones are dropped and counted."""


class Numbered(NamedTuple):
    """An event, and its place among all events of the session, from 1 on."""

    number: int
    event: RunEvent


class Feed:
    """Sink that keeps recent events. Belongs to the thread of the event loop."""

    def __init__(self) -> None:
        self._events: deque[Numbered] = deque(maxlen=EVENTS_LIMIT)
        self._count = 0
        """Of all events so far; each has its number from it."""
        self._lines: dict[str, _Lines] = {}
        self._followers: list[Callable[[Numbered], None]] = []
        self._loop: asyncio.AbstractEventLoop | None = None

    def begin(self) -> None:
        self._loop = asyncio.get_running_loop()

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:  # noqa: ARG002 - a sink
        self._append(event)

    def publish_log(self, event: LogRecord) -> None:
        """Keep a log record; may be called in any thread."""
        if self._loop is None:
            self._append(event)
            return
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._append, event)

    def recent(self, since: int = 0) -> list[Numbered]:
        """Return the events that are kept, by their stamps: those after the number ``since``."""
        lines = (line for each in self._lines.values() for line in each.lines)
        found = [each for each in (*self._events, *lines) if each.number > since]
        return sorted(found, key=lambda each: each.event.stamp_ns)

    @contextlib.contextmanager
    def followed_by(self, follower: Callable[[Numbered], None]) -> Iterator[None]:
        """Call ``follower`` with every event while the block runs, samples included."""
        self._followers.append(follower)
        try:
            yield
        finally:
            self._followers.remove(follower)

    def _append(self, event: RunEvent) -> None:
        self._count += 1
        numbered = Numbered(self._count, event)
        if isinstance(event, OutputLine):
            lines = self._lines.get(event.process)
            if lines is None:
                lines = self._lines[event.process] = _Lines()
            lines.append(numbered, len(event.text))
        elif not isinstance(event, Sample):
            self._events.append(numbered)
        for follower in self._followers:
            follower(numbered)


class _Lines:
    """The last lines of one process."""

    def __init__(self) -> None:
        self.lines: deque[Numbered] = deque()
        self._sizes: deque[int] = deque()
        self._text = 0

    def append(self, line: Numbered, size: int) -> None:
        self.lines.append(line)
        self._sizes.append(size)
        self._text += size
        while len(self.lines) > LINES_LIMIT or (self._text > TEXT_LIMIT and len(self.lines) > 1):
            self.lines.popleft()
            self._text -= self._sizes.popleft()


class Selection:
    """Kinds of events (none: the usual ones), and the units that they are about (None: all)."""

    def __init__(self, kinds: Iterable[str], targets: Sequence[NodeKey | str] | None) -> None:
        self._kinds = frozenset(kinds) or USUAL_KINDS
        nodes = [each.name for each in targets or () if isinstance(each, NodeKey)]
        members = [each for each in targets or () if isinstance(each, str)]
        self._names = None if targets is None else {*nodes, *members}
        # The output of nodes comes through their container.
        self._loggers = {*map(logger_of, nodes)}

    def wants(self, event: RunEvent) -> bool:
        if EVENT_TYPES[type(event)] not in self._kinds:
            return False
        if self._names is None or not self._names.isdisjoint(names_of(event)):
            return True
        if not self._loggers or not isinstance(event, OutputLine):
            return False
        return not self._loggers.isdisjoint(loggers_in(event.text))


class Follower:
    """Queue of the events for one client, which may read slowly or never."""

    def __init__(self, selection: Selection) -> None:
        self._selection = selection
        self._queue: asyncio.Queue[Numbered] = asyncio.Queue(QUEUE_LIMIT)
        self._missed = 0

    def append(self, each: Numbered) -> None:
        if self._selection.wants(each.event):
            try:
                self._queue.put_nowait(each)
            except asyncio.QueueFull:
                self._missed += 1

    async def send_all(self, events: Iterable[Numbered], send: Send) -> None:
        for each in events:
            if self._selection.wants(each.event):
                await send("event", _message(each))

    async def follow(self, send: Send) -> None:
        """Send queued events until this is cancelled, and how many were dropped."""
        while True:
            await send("event", _message(await self._queue.get()))
            if self._missed and self._queue.empty():
                missed, self._missed = self._missed, 0
                await send("missed", missed)


def _message(each: Numbered) -> dict[str, object]:
    """Return the fields of an event, its words and its number."""
    return event_object(each.event) | words_of(each.event)._asdict() | {"number": each.number}
