"""What was written and logged in a session, as much of it as a page can hold."""

from __future__ import annotations

import re
from array import array
from bisect import bisect_left
from typing import TYPE_CHECKING, Final

from msgspec import Struct, field

from play_launch.postmortem.report.page import shown
from play_launch.postmortem.timeline import Timeline  # noqa: TC001 - a field of a Struct
from play_launch.recording.console_format import WARN

if TYPE_CHECKING:
    from play_launch.container.cdr.messages import LogFields

MOST: Final = 400_000
"""Lines."""
MOST_TEXT: Final = 48_000_000
"""Characters."""
AROUND: Final = 10_000.0
"""Milliseconds before and after a failure in which every line is kept."""
_HEAD: Final = re.compile(
    r"(?:\x1b\[[0-9;]*m)*\[\s*[A-Z]{4,8}\s*\] \[[0-9.]+\] \[([^\]\n]{1,255})\]: "
)
"""What ROS's console format puts before a message: severity, time and logger."""


class Lines(Struct):
    """Columns of lines in the order of time; times are milliseconds since the start.

    When there are too many, those below WARN are left out that are not close to a failure, and the
    earliest others if that is not enough.
    """

    timeline: Timeline
    most: int = MOST
    most_text: int = MOST_TEXT
    times: array[float] = field(default_factory=lambda: array("d"))
    rows: array[int] = field(default_factory=lambda: array("H"))
    levels: array[int] = field(default_factory=lambda: array("B"))
    texts: list[str] = field(default_factory=list)
    left_out: int = 0
    _text: int = 0
    _failures: list[float] = field(default_factory=list)
    _loggers: dict[tuple[str, str], int] = field(default_factory=dict)
    """Numbers of nodes by their containers and loggers."""
    _named: int = 0
    """Units whose loggers are known."""

    def output(self, at: float, line: LogFields) -> None:
        """Take a line of output; its head is left out where the columns say the same."""
        text, own = line.message, None
        head = _HEAD.match(text)
        if head:
            if self._named < len(self.timeline.units):
                self._name_loggers()
            logger, text = head[1], text[head.end() :]
            own = self._loggers.get((line.name, logger))
            if own is None:
                text = f"[{logger}]: {text}"
                # A logger's name is that of its node with dots, perhaps with more behind it.
                while own is None and logger:
                    logger = logger.rpartition(".")[0]
                    own = self._loggers.get((line.name, logger))
        if own is None:
            own = self.timeline.of_name(line.name).number
        self.add(at, own, line.level, text)

    def _name_loggers(self) -> None:
        units = self.timeline.units
        for unit in units[self._named :]:
            if unit.container:
                logger = unit.name.removeprefix("/").replace("/", ".")
                self._loggers[unit.container, logger] = unit.number
        self._named = len(units)

    def failure(self, at: float) -> None:
        """Keep what is written around this moment."""
        self._failures.append(at)

    def add(self, at: float, row: int, level: int, text: str) -> None:
        """Take a text of one or more lines."""
        if self.times:
            at = max(at, self.times[-1])
        for line in (text,) if text.isprintable() else shown(text).split("\n"):
            self.times.append(at)
            self.rows.append(row)
            self.levels.append(level)
            self.texts.append(line)
            self._text += len(line)
        if len(self.texts) > 1.5 * self.most or self._text > 1.5 * self.most_text:
            self.prune()

    def prune(self) -> None:
        """Leave out what is too much; what is written at this moment is kept as well."""
        if len(self.texts) <= self.most and self._text <= self.most_text:
            return
        latest = self.times[-1]
        keep = [
            index
            for index, (at, level) in enumerate(zip(self.times, self.levels, strict=True))
            if level >= WARN or at > latest - AROUND or self._is_close(at)
        ]
        count, text = len(keep), sum(len(self.texts[index]) for index in keep)
        first = 0
        while count > self.most or text > self.most_text:
            text -= len(self.texts[keep[first]])
            count -= 1
            first += 1
        self._only(keep[first:])

    def _is_close(self, at: float) -> bool:
        place = bisect_left(self._failures, at - AROUND)
        return place < len(self._failures) and self._failures[place] <= at + AROUND

    def _only(self, keep: list[int]) -> None:
        self.left_out += len(self.texts) - len(keep)
        self.times = array("d", [self.times[index] for index in keep])
        self.rows = array("H", [self.rows[index] for index in keep])
        self.levels = array("B", [self.levels[index] for index in keep])
        self.texts = [self.texts[index] for index in keep]
        self._text = sum(map(len, self.texts))
