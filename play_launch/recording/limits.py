"""What a recorder takes at most, and what it reports."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, NamedTuple

from msgspec import Struct

from play_launch.recording.console_format import WARN
from play_launch.supervisor.events import LogRecord

if TYPE_CHECKING:
    from collections import Counter
    from pathlib import Path

LOGGER: Final = "play_launch.recording"
_NAMED_PROCESSES: Final = 5
"""Processes that a report of drops names."""


class RecorderLimits(Struct, frozen=True):
    """Sizes and times of a recorder; the defaults suit a run of a few hundred nodes."""

    lines: int = 50_000
    """Output lines waiting to be written; further ones are dropped and counted."""
    text: int = 32 * 1024 * 1024
    """Characters of output waiting to be written."""
    other_events: int = 10_000
    """Room for other events when ``lines`` is used up: output must not drive out state events."""
    batch: float = 0.05
    """Seconds to gather events before they are written together."""
    flush: float = 0.05
    """Seconds that a written message may wait for the end of its chunk. With ``batch`` this is what
    a SIGKILL can cost; it leaves 0.15 s of the promised 0.25 s to a busy machine."""
    failure_gap: float = 0.01
    """Least seconds between two chunks that end early because of a failure."""
    retry: float = 0.5
    """Seconds until a file that took no data is tried again; twice as long each time, up to"""
    longest_retry: float = 10.0
    close: float = 10.0
    """Seconds to wait at the end for what is still to be written."""


class DroppedEvents(NamedTuple):
    """Events that found no room, since the last report; times are nanoseconds since the epoch."""

    lines: Counter[str]
    """Lines of output by process."""
    others: int = 0
    since_ns: int = 0
    """0 without any."""
    until_ns: int = 0

    @property
    def when(self) -> str:
        times = (time.localtime(at / 1e9) for at in (self.since_ns, self.until_ns))
        return "from {} to {}".format(*(time.strftime("%H:%M:%S", each) for each in times))

    def report(self) -> LogRecord:
        text = f"dropped {self}: they came faster than they could be written"
        return LogRecord(stamp_ns=time.time_ns(), level=WARN, name=LOGGER, message=text)

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


class RecordingSummary(Struct, frozen=True):
    """Result of a recording."""

    path: Path
    """The file; it still ends in ``.active`` when it could not be completed. With several files
    the folder that holds them."""
    messages: int
    """Messages that are in it."""
    dropped: int
    """Events that are not in it."""
    bytes: int
    parts: int = 1
    """Number of files."""
    removed_parts: int = 0
    """Number of earlier files that were removed (`record.keep.size`)."""
    topic_drops: int = 0
    """Messages of ROS's topics that are not in it."""
    interruptions: int = 0
    """How often it took no data for some time, for example on a full disk."""
    error: str = ""
    """Why the recording stopped early, and the fix; empty when it is complete."""
