"""What waits to be recorded: bounded, and what finds no room is counted."""

from __future__ import annotations

import threading
import time
from collections import Counter
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.supervisor.events import OutputLine, Sample

if TYPE_CHECKING:
    from play_launch.recording.decisions import Decision
    from play_launch.recording.recorder import RecorderLimits
    from play_launch.supervisor.events import RunEvent

_NAMED_PROCESSES: Final = 5
"""How many processes a report of drops names; the rest is summed up."""


class Drops(NamedTuple):
    """Events that found no room; times are nanoseconds since the epoch."""

    lines: Counter[str]
    """Lines of output by process."""
    others: int
    since_ns: int
    until_ns: int

    def __bool__(self) -> bool:
        return bool(self.lines) or self.others > 0

    def __str__(self) -> str:
        parts: list[str] = []
        if lines := self.lines.total():
            named = [f"{name} {count}" for name, count in self.lines.most_common(_NAMED_PROCESSES)]
            if len(self.lines) > _NAMED_PROCESSES:
                named.append("…")
            parts.append(f"{lines} lines of output ({', '.join(named)})")
        if self.others:
            parts.append(f"{self.others} other events")
        return " and ".join(parts)


class Batch(NamedTuple):
    """What waited."""

    events: list[tuple[int, RunEvent | Decision]]
    """With the time when each came, in nanoseconds since the epoch."""
    drops: Drops
    is_last: bool


class EventQueue:
    """Takes events in any thread, gives them to one."""

    def __init__(self, limits: RecorderLimits) -> None:
        self._limits = limits
        self._lock = threading.Lock()
        self._waiting: list[tuple[int, RunEvent | Decision]] = []
        self._text = 0
        self._lines: Counter[str] = Counter()
        self._others = 0
        self._since = 0
        self._until = 0
        self._is_closed = False
        self.dropped = 0
        """Events that found no room so far."""

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, event: RunEvent | Decision) -> bool:
        """Take an event; return whether it is the first one that waits."""
        with self._lock:
            received = time.time_ns()  # here, so that they are in the order of their times
            if not self._has_room(event):
                self._drop(event, received)
                return False
            self._waiting.append((received, event))
            if isinstance(event, OutputLine):
                self._text += len(event.text)
            return len(self._waiting) == 1

    def take(self) -> Batch:
        """Give everything that waits, and what was dropped since the last time."""
        with self._lock:
            waiting, self._waiting = self._waiting, []
            self._text = 0
            return Batch(waiting, self._forget_drops(), self._is_closed)

    def take_drops(self) -> Drops:
        """Give what was dropped since the last time."""
        with self._lock:
            return self._forget_drops()

    def close(self) -> None:
        """Drop whatever comes from now on."""
        with self._lock:
            self._is_closed = True

    def _has_room(self, event: RunEvent | Decision) -> bool:
        if self._is_closed:
            return False
        waiting = len(self._waiting)
        if isinstance(event, OutputLine):
            return waiting < self._limits.lines and self._text < self._limits.text
        if isinstance(event, Sample):
            # They come without end as well, and say less than what happened.
            return waiting < self._limits.lines
        return waiting < self._limits.lines + self._limits.other_events

    def _forget_drops(self) -> Drops:
        drops = Drops(self._lines, self._others, self._since, self._until)
        self._lines, self._others = Counter(), 0
        return drops

    def _drop(self, event: RunEvent | Decision, received: int) -> None:
        if not self._lines and not self._others:
            self._since = received
        self._until = received
        self.dropped += 1
        if isinstance(event, OutputLine):
            self._lines[event.process] += 1
        else:
            self._others += 1
