"""Styles for people: lines that stay, and above all a live view where there is a terminal."""

from __future__ import annotations

import time
import zlib
from typing import IO, TYPE_CHECKING, Final

from play_launch.cli.output import RESET, clock, printable
from play_launch.cli.show.lines import OWN_NAME, Line, line_of
from play_launch.recording.console_format import ERROR, WARN
from play_launch.supervisor.events import LogRecord, OutputLine, RunEvent, Sample
from play_launch.supervisor.view import SystemView

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.console import Console
    from rich.live import Live

    from play_launch.cli.show.display import Shown

_REDRAW: Final = 0.5
"""Seconds between two frames while something is pending."""
_ERROR_COLOUR: Final = "\x1b[31m"
_WARNING_COLOUR: Final = "\x1b[33m"
_NAME_COLOURS: Final = tuple(f"\x1b[{code}m" for code in (36, 35, 34, 32, 96, 95, 94, 92))


class PlainStyle:
    """Lines with a time, for files, pipes and journals."""

    def __init__(self, stream: IO[str], *, quiet: bool, colour: bool) -> None:
        """``quiet`` leaves the output of nodes away."""
        self._stream = stream
        self._quiet = quiet
        self._colour = colour

    def wants(self, event: RunEvent) -> bool:
        """Everything that may have a line."""
        return _wants(event, quiet=self._quiet)

    def show(self, batch: Sequence[Shown], missed: int) -> float | None:
        """Write the lines of the events."""
        lines = [line for line in (line_of(*shown) for shown in batch) if line]
        if missed:
            lines.append(missed_line(missed))
        if lines:
            self._stream.write(format_lines(lines, times=True, colour=self._colour))
            self._stream.flush()
        return None

    def close(self) -> None:
        """Nothing to restore."""


class LiveStyle:
    """On a terminal: lines scroll by above a view of what is up and what is missing."""

    def __init__(self, console: Console, *, quiet: bool, colour: bool) -> None:
        """``console`` is a terminal; ``quiet`` leaves the output of nodes away."""
        self._console = console
        self._quiet = quiet
        self._colour = colour
        self._view = SystemView()
        self._live: Live | None = None

    def wants(self, event: RunEvent) -> bool:
        """Everything that changes the view or may have a line."""
        return _wants(event, quiet=self._quiet)

    def show(self, batch: Sequence[Shown], missed: int) -> float | None:
        """Write lines above the view and draw it again."""
        from rich.live import Live  # noqa: PLC0415 - not needed where there is no terminal

        from play_launch.cli.show.live_view import live_view  # noqa: PLC0415

        if self._live is None:
            self._live = Live(
                console=self._console,
                auto_refresh=False,
                transient=True,
                redirect_stdout=False,
                redirect_stderr=False,
            )
            self._live.start()
        for shown in batch:
            if not isinstance(shown.event, LogRecord):
                self._view = shown.after
        lines = [line for line in (line_of(*shown) for shown in batch) if line]
        lines = [line for line in lines if not line.is_progress]
        if missed:
            lines.append(missed_line(missed))
        if lines:
            text = format_lines(lines, times=False, colour=self._colour)
            self._console.out(text, end="", highlight=False)
        now_ns = time.time_ns()
        self._live.update(live_view(self._view, now_ns, self._console.height), refresh=True)
        return _REDRAW if self._view.waiting or self._view.total == 0 else None

    def close(self) -> None:
        """Take the view away; the summary follows."""
        if self._live is not None:
            self._live.stop()


def _wants(event: RunEvent, *, quiet: bool) -> bool:
    if isinstance(event, OutputLine):
        return not quiet
    if isinstance(event, LogRecord):
        return event.level >= WARN
    return not isinstance(event, Sample)


def missed_line(missed: int) -> Line:
    """Make the line about skipped lines."""
    text = f"skipped {missed} lines (the terminal is too slow); they are in the recording"
    return Line(time.time_ns(), OWN_NAME, text, WARN)


def format_lines(lines: Iterable[Line], *, times: bool, colour: bool) -> str:
    """Lay out lines, each with its source in front; every one ends in a line end.

    Node output is cleaned of what would disturb the terminal; a message of several lines gets the
    source in front of each.
    """
    written: list[str] = []
    for line in lines:
        head = f"{clock(line.stamp_ns)} " if times else ""
        if colour:
            head += f"{_name_colour(line.source)}[{line.source}]{RESET} "
        else:
            head += f"[{line.source}] "
        for text in line.text.split("\n"):
            clean = printable(text, colour=colour)
            if colour and line.level >= WARN:
                paint = _ERROR_COLOUR if line.level >= ERROR else _WARNING_COLOUR
                clean = f"{paint}{clean}{RESET}"
            written.append(f"{head}{clean}\n")
    return "".join(written)


def _name_colour(name: str) -> str:
    # By name, not by order of appearance: a node keeps its colour from run to run.
    return _NAME_COLOURS[zlib.crc32(name.encode("utf-8", "replace")) % len(_NAME_COLOURS)]
