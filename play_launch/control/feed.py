"""Recent events of a run, and the clients that follow them."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import deque
from heapq import merge
from operator import itemgetter
from typing import TYPE_CHECKING, Final, Generic, NamedTuple, TypeVar

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
_MISSED_PERIOD: Final = 5.0
"""Seconds between two reports of what a slow client missed."""


class FeedLimits(NamedTuple):
    """How much is held; further messages displace the oldest ones."""

    events: int
    """Events other than output."""
    lines: int
    """Lines of output of each process."""
    text: int
    """Characters of these lines."""


KEPT: Final = FeedLimits(events=2000, lines=300, text=64 * 1024)
"""Of recent events; the recording has all."""
WAITING: Final = FeedLimits(events=5000, lines=5000, text=256 * 1024)
"""For one client."""

_T = TypeVar("_T")


class Backlog(Generic[_T]):
    """The latest messages in their order; lines of a process displace only older lines of it."""

    def __init__(self, limits: FeedLimits) -> None:
        self._limits = limits
        self._count = 0
        self._events: deque[tuple[int, _T]] = deque()
        self._lines: dict[str, _LinesOfProcess[_T]] = {}

    def append(self, message: _T, process: str = "", size: int = 0) -> int:
        """Take a message, and return how many it displaced.

        With ``process`` it is a line of output of that, of ``size`` characters.
        """
        self._count += 1
        numbered = (self._count, message)
        if process:
            lines = self._lines.setdefault(process, _LinesOfProcess())
            return lines.append(numbered, size, self._limits)
        self._events.append(numbered)
        if len(self._events) <= self._limits.events:
            return 0
        self._events.popleft()
        return 1

    def __bool__(self) -> bool:
        return bool(self._events or self._lines)

    def __iter__(self) -> Iterator[_T]:
        lines = (each.messages for each in self._lines.values())
        return (message for _, message in merge(self._events, *lines, key=itemgetter(0)))

    def pop(self) -> _T:
        """Take the oldest message out."""
        oldest = min(self._lines, key=lambda each: self._lines[each].messages[0][0], default=None)
        if oldest is None:
            return self._events.popleft()[1]
        lines = self._lines[oldest]
        if self._events and self._events[0][0] < lines.messages[0][0]:
            return self._events.popleft()[1]
        _, message = lines.pop()
        if not lines.messages:
            del self._lines[oldest]
        return message


class _LinesOfProcess(Generic[_T]):
    """The last lines of one process."""

    def __init__(self) -> None:
        self.messages: deque[tuple[int, _T]] = deque()
        self._sizes: deque[int] = deque()
        self._text = 0

    def append(self, message: tuple[int, _T], size: int, limits: FeedLimits) -> int:
        self.messages.append(message)
        self._sizes.append(size)
        self._text += size
        count = len(self.messages)
        while len(self.messages) > limits.lines or (
            self._text > limits.text and len(self.messages) > 1
        ):
            self.pop()
        return count - len(self.messages)

    def pop(self) -> tuple[int, _T]:
        self._text -= self._sizes.popleft()
        return self.messages.popleft()


class Numbered(NamedTuple):
    """An event, and its place among all events of the session, from 1 on."""

    number: int
    event: RunEvent


class Feed:
    """Sink that keeps recent events. Belongs to the thread of the event loop."""

    def __init__(self) -> None:
        self._kept: Backlog[Numbered] = Backlog(KEPT)
        self._count = 0
        """Of all events so far; each has its number from it."""
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
        found = [each for each in self._kept if each.number > since]
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
        if not isinstance(event, Sample):
            self._kept.append(numbered, *line_of(event))
        for follower in self._followers:
            follower(numbered)


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


class ClientQueue:
    """Messages that wait for one client, which may read slowly or never."""

    def __init__(self) -> None:
        self._backlog: Backlog[Callable[[], object]] = Backlog(WAITING)
        self._missed = 0
        self._arrived = asyncio.Event()

    def append(self, message: Callable[[], object], process: str = "", size: int = 0) -> None:
        """Take a message as `Backlog.append` does; it is made when it is sent."""
        self._missed += self._backlog.append(message, process, size)
        self._arrived.set()

    async def send(self, send: Send) -> None:
        """Send messages until this is cancelled, and how many were missed."""
        loop = asyncio.get_running_loop()
        told = -math.inf
        while True:
            while self._backlog:
                await send("event", self._backlog.pop()())
                if self._missed and (not self._backlog or loop.time() > told + _MISSED_PERIOD):
                    told = loop.time()
                    missed, self._missed = self._missed, 0
                    await send("missed", missed)
            self._arrived.clear()
            await self._arrived.wait()


def line_of(event: RunEvent) -> tuple[str, int]:
    """Return process and size of a line of output; of another event the empty string and 0."""
    return (event.process, len(event.text)) if isinstance(event, OutputLine) else ("", 0)


def message_of(each: Numbered) -> dict[str, object]:
    """Return the fields of an event, its words and its number."""
    return event_object(each.event) | words_of(each.event)._asdict() | {"number": each.number}
