"""Lines of the log: parsed from events, filtered by node and level, and each row's last one."""

from __future__ import annotations

import time
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct
from rich.text import Text

from play_launch.cli.top.rows import COMPONENT, Row, RowId, clean
from play_launch.control.feed import CONSOLE_FORMAT, logger_of
from play_launch.recording.console_format import line_level
from play_launch.supervisor.events import OutputLine, Stream

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

LINES_LIMIT: Final = 5000
"""Lines that are kept."""
OWN_NAME: Final = "play-launch"


class LeastLevel(IntEnum):
    """Least severity of the shown lines, as in ``rcl_interfaces/Log``."""

    ALL = 0
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50

    def next(self) -> LeastLevel:
        """The level above, in a circle."""
        levels = list(LeastLevel)
        return levels[(levels.index(self) + 1) % len(levels)]


class LogLine(Struct, frozen=True):
    """One line of output or of the supervisor's log."""

    stamp_ns: int
    level: int
    process: str
    """Full name of the container or process; `OWN_NAME` for the supervisor's log."""
    logger: str
    """Logger of ROS; empty if the line does not name one."""
    text: str
    """Clean, without what is in the other fields."""


def line_of(event: Mapping[str, Any]) -> LogLine:
    """Parse an event of kind output or log; raises KeyError, TypeError, ValueError."""
    stamp = int(event["stamp_ns"])
    if event["event"] == "log":
        return LogLine(stamp, int(event["level"]), OWN_NAME, "", clean(str(event["message"])))
    text = str(event["text"])
    line = OutputLine(stamp_ns=stamp, process="", pid=0, stream=Stream(event["stream"]), text=text)
    found = CONSOLE_FORMAT.match(text)
    logger, message = (clean(found[1]), text[found.end() :]) if found else ("", text)
    return LogLine(stamp, line_level(line), str(event["process"]), logger, clean(message))


class LogFilter(Struct, frozen=True):
    """Which lines are shown."""

    level: LeastLevel = LeastLevel.ALL
    subject: RowId | None = None
    """None: lines of all, the supervisor included."""

    def wants(self, line: LogLine) -> bool:
        """Whether a line is shown."""
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


_LETTERS: Final = {10: "D", 20: "I", 30: "W", 40: "E", 50: "F"}
_STYLES: Final = {30: "yellow", 40: "bold red", 50: "bold red"}


def shown(line: LogLine) -> Text:
    """Format a line: time of day, severity, source, text."""
    clock = time.strftime("%H:%M:%S", time.localtime(line.stamp_ns // 1_000_000_000))
    source = line.logger or clean(line.process)
    text = f"{clock} {_LETTERS.get(line.level, '?')} {source}: {line.text}"
    return Text(text, _STYLES.get(line.level, ""))


class RowLines:
    """The last line of output of each row."""

    def __init__(self) -> None:
        self._owners: dict[tuple[str, str], RowId] = {}
        self._last: dict[RowId, str] = {}

    def declare(self, rows: Iterable[Row]) -> None:
        """Set the rows; lines of other ones are forgotten."""
        subjects = {row.subject for row in rows}
        self._owners = {
            (row.container or "", logger_of(row.name)): row.subject
            for row in rows
            if row.kind == COMPONENT
        }
        self._last = {subject: text for subject, text in self._last.items() if subject in subjects}

    def add(self, line: LogLine) -> None:
        """Add a line; it belongs to its process and to the node of its logger or one above."""
        if line.process == OWN_NAME:
            return
        self._last[RowId(None, line.process)] = line.text
        name = line.logger
        while name:
            owner = self._owners.get((line.process, name))
            if owner is not None:
                self._last[owner] = line.text
                return
            name = name.rpartition(".")[0]

    def of(self, subject: RowId) -> str:
        """Return the last line; empty without one."""
        return self._last.get(subject, "")
