"""What the session writes: the lines that are kept, chosen by node and level, and each one's last.

All of it is bounded; what goes is counted.
"""

from __future__ import annotations

import time
from collections import deque
from enum import IntEnum
from itertools import takewhile
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from play_launch.cli.top.cells import clean, wrapped
from play_launch.cli.top.rows import COMPONENT, Row, Subject
from play_launch.control.feed import CONSOLE_FORMAT, logger_of
from play_launch.recording.console_format import line_level
from play_launch.supervisor.events import OutputLine, Stream

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

MOST_LINES: Final = 5000
MOST_TEXT: Final = 1024 * 1024
"""Characters of these lines."""
OWN_NAME: Final = "play-launch"


class Level(IntEnum):
    """Least severity of lines that are shown, as in ``rcl_interfaces/Log``."""

    ALL = 0
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50

    def next(self) -> Level:
        """The one above, in a circle."""
        levels = list(Level)
        return levels[(levels.index(self) + 1) % len(levels)]


class LogLine(Struct, frozen=True):
    """One line of output or of the supervisor's log."""

    stamp_ns: int
    level: int
    process: str
    """Full name of the container or process that wrote it; of our own log `OWN_NAME`."""
    logger: str
    """Of ROS; empty where the line does not say one."""
    text: str
    """Clean, without what is in the other fields."""


def line_of(event: Mapping[str, Any]) -> LogLine | None:
    """Read an event of the control socket; None where it is no line.

    Raises:
        KeyError, TypeError, ValueError: When it is not what docs/control.md says.
    """
    if event["event"] == "log":
        text = clean(str(event["message"]))
        return LogLine(int(event["stamp_ns"]), int(event["level"]), OWN_NAME, "", text)
    if event["event"] != "output":
        return None
    text = str(event["text"])
    stamp = int(event["stamp_ns"])
    line = OutputLine(stamp_ns=stamp, process="", pid=0, stream=Stream(event["stream"]), text=text)
    level = line_level(line)
    found = CONSOLE_FORMAT.match(text)
    said = text if found is None else text[found.end() :]
    logger = "" if found is None else clean(found[1])
    return LogLine(stamp, level, str(event["process"]), logger, clean(said))


class LogFilter(Struct, frozen=True):
    """Which lines are shown."""

    level: Level = Level.ALL
    subject: Subject | None = None
    """Of this one; None: of all, the supervisor included."""

    def wants(self, line: LogLine) -> bool:
        """Whether a line is among them."""
        if line.level < self.level:
            return False
        if self.subject is None:
            return True
        container, name = self.subject
        if container is None:
            return line.process == name
        own = logger_of(name)
        is_own = line.logger == own or line.logger.startswith(f"{own}.")
        return line.process == container and is_own


class LogBuffer:
    """The last lines, each with a number that it keeps."""

    def __init__(self) -> None:
        self._lines: deque[LogLine] = deque()
        self._text = 0
        self.gone = 0
        """Lines that were kept and gave way to newer ones; the number of the first that is kept."""
        self.missed = 0
        """Events that the session could not send, because there were too many."""

    def __len__(self) -> int:
        return len(self._lines)

    @property
    def end(self) -> int:
        """The number that the next line will have."""
        return self.gone + len(self._lines)

    def append(self, line: LogLine) -> None:
        """Keep a line."""
        self._lines.append(line)
        self._text += len(line.text)
        while len(self._lines) > MOST_LINES or self._text > MOST_TEXT:
            self._text -= len(self._lines.popleft().text)
            self.gone += 1

    def before(self, end: int, wanted: LogFilter) -> Iterable[tuple[int, LogLine]]:
        """Go through the wanted lines with numbers below ``end``, the newest first."""
        for back, line in enumerate(reversed(self._lines)):
            number = self.end - 1 - back
            if number < end and wanted.wants(line):
                yield number, line

    def after(self, end: int, wanted: LogFilter) -> int:
        """Count the wanted lines from a number on."""
        numbers = (number for number, _ in self.before(self.end, wanted))
        return sum(1 for _ in takewhile(lambda number: number >= end, numbers))


def page(
    buffer: LogBuffer, wanted: LogFilter, end: int, width: int, height: int
) -> list[tuple[LogLine, str]]:
    """Lay out the lines that fill a pane from below, the oldest first; long ones take several.

    Args:
        buffer: What there is.
        wanted: Which of them.
        end: The number behind the last line to be shown.
        width: In cells.
        height: In lines.
    """
    laid: list[tuple[LogLine, str]] = []
    if width <= 0 or height <= 0:
        return laid
    for _, line in buffer.before(end, wanted):
        pieces = wrapped(shown(line), width)
        laid += [(line, piece) for piece in reversed(pieces)]
        if len(laid) >= height:
            break
    return laid[:height][::-1]


def scrolled(buffer: LogBuffer, wanted: LogFilter, end: int | None, lines: int) -> int | None:
    """Move the end of what is shown.

    Args:
        buffer: What there is.
        wanted: Which of them.
        end: As for `page`; None: behind whatever comes.
        lines: How many wanted lines further down, or up where negative.

    Returns:
        The new end. None when that is behind the newest line: what comes is followed again.
    """
    numbers = [number for number, _ in buffer.before(buffer.end, wanted)]  # newest first
    place = 0 if end is None else sum(number >= end for number in numbers)
    place = min(place - lines, len(numbers) - 1)
    return None if place <= 0 else numbers[place] + 1


def shown(line: LogLine) -> str:
    """Write a line for a person: time of day, severity, who, what."""
    clock = time.strftime("%H:%M:%S", time.localtime(line.stamp_ns // 1_000_000_000))
    who = line.logger or clean(line.process)
    return f"{clock} {_LETTERS.get(line.level, '?')} {who}: {line.text}"


_LETTERS: Final = {10: "D", 20: "I", 30: "W", 40: "E", 50: "F"}


class LastLines:
    """What each of the rows wrote last."""

    def __init__(self) -> None:
        self._owners: dict[tuple[str, str], Subject] = {}
        self._last: dict[Subject, str] = {}

    def declare(self, rows: Iterable[Row]) -> None:
        """Know which rows there are; what is about none of them is forgotten."""
        subjects = {row.subject for row in rows}
        self._owners = {
            (row.container or "", logger_of(row.name)): row.subject
            for row in rows
            if row.kind == COMPONENT
        }
        self._last = {subject: text for subject, text in self._last.items() if subject in subjects}

    def see(self, line: LogLine) -> None:
        """Take a line of output; a node gets those that its logger, or one below it, wrote."""
        if line.process == OWN_NAME:
            return
        self._last[Subject(None, line.process)] = line.text
        name = line.logger
        while name:
            owner = self._owners.get((line.process, name))
            if owner is not None:
                self._last[owner] = line.text
                return
            name = name.rpartition(".")[0]

    def of(self, subject: Subject) -> str:
        """What it wrote last; empty: nothing yet."""
        return self._last.get(subject, "")
