"""``play-launch inspect``: what happened in a session, line by line."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import datetime
from fnmatch import fnmatchcase
from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated, Final

import typer

from play_launch.cli.failure import fail
from play_launch.cli.info import report_damage
from play_launch.cli.show.json_style import encode, event_object
from play_launch.cli.show.lines import Line, line_of
from play_launch.cli.show.terminal import printable, say
from play_launch.config.values import parse_duration
from play_launch.core.events import (
    ComponentEvent,
    ComponentEventKind,
    ContainerStateChanged,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    RunEvent,
)
from play_launch.history.bag_reader import NotARecordingError
from play_launch.history.session import Happened, PastSession
from play_launch.recording.console_format import DEBUG, ERROR, FATAL, INFO, WARN

_DAMAGED: Final = 3
_AROUND: Final = 5.0
"""Seconds on either side of a moment."""
_LEVELS: Final = {"debug": DEBUG, "info": INFO, "warn": WARN, "error": ERROR, "fatal": FATAL}
_CLOCK: Final = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:\.\d+)?)")


def inspect(  # noqa: PLR0917 - options, by name
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A session.mcap.", show_default=False)
    ],
    node: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Only this node, container or process; * and ? are patterns. May be repeated.",
            show_default=False,
        ),
    ] = None,
    level: Annotated[
        str, typer.Option(metavar="LEVEL", help="debug, info, warn, error or fatal, and above.")
    ] = "info",
    since: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="From this time after the start (12.5s, 2min) or of the day (14:03:07) on.",
            show_default=False,
        ),
    ] = None,
    until: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="Up to this time.", show_default=False),
    ] = None,
    around: Annotated[
        str | None,
        typer.Option(
            metavar="TIME", help="Five seconds before and after this time.", show_default=False
        ),
    ] = None,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Events as JSON, one object a line, as of replay --json."),
    ] = False,
) -> None:
    """Show what happened: starts, loads, crashes with their backtraces, restarts, output and log.

    Times are seconds after the start. It reads damaged and unfinished recordings (.active) as far
    as that is possible, and then exits with 3; with 2 when the file is not a recording, else 0.
    """
    if level not in _LEVELS:
        fail(f"--level {level}: use one of {', '.join(_LEVELS)}")
    if around is not None and (since is not None or until is not None):
        fail("--around already says since when and until when")
    session = PastSession(file)
    try:
        window: Window | None = None
        for happened in session.events():
            if window is None:
                window = _window(session.started_ns, since, until, around)
            if happened.log_time not in window or not _concerns(happened.event, node):
                continue
            _show(happened, session.started_ns, _LEVELS[level], as_json=as_json)
    except NotARecordingError as error:
        fail(str(error))
    if report_damage(session.reader):
        raise typer.Exit(_DAMAGED)


@dataclass(frozen=True, slots=True)
class Window:
    """A time from and up to which events count, both included; nanoseconds since the epoch."""

    begin: float
    end: float

    def __contains__(self, stamp_ns: int) -> bool:
        return self.begin <= stamp_ns <= self.end


def _window(started_ns: int, since: str | None, until: str | None, around: str | None) -> Window:
    if around is not None:
        middle = _moment("--around", around, started_ns)
        return Window(middle - _AROUND * 1e9, middle + _AROUND * 1e9)
    return Window(
        float("-inf") if since is None else _moment("--since", since, started_ns),
        float("inf") if until is None else _moment("--until", until, started_ns),
    )


def _moment(option: str, text: str, started_ns: int) -> float:
    if clock := _CLOCK.fullmatch(text):
        start = datetime.fromtimestamp(started_ns / 1e9).astimezone()
        midnight = start.replace(hour=0, minute=0, second=0, microsecond=0)
        hours, minutes, seconds = int(clock[1]), int(clock[2]), float(clock[3])
        return (midnight.timestamp() + 3600 * hours + 60 * minutes + seconds) * 1e9
    try:
        return started_ns + parse_duration(text) * 1e9
    except ValueError as error:
        fail(f"{option} {text}: {error}")


def _concerns(event: RunEvent, patterns: list[str] | None) -> bool:
    if not patterns:
        return True
    return any(fnmatchcase(name, pattern) for name in _names(event) for pattern in patterns)


def _names(event: RunEvent) -> tuple[str, ...]:
    match event:
        case NodeStateChanged():
            return event.node, event.container
        case ContainerStateChanged():
            return (event.container,)
        case ProcessEvent():
            return (event.name,)
        case OutputLine():
            return (event.process,)
        case ComponentEvent():
            return (event.full_node_name,)
        case _:
            return ()


def _show(happened: Happened, started_ns: int, level: int, *, as_json: bool) -> None:
    line = _line(happened)
    if as_json:
        if line is None or line.level >= level:
            say(encode(event_object(happened.event)))
        return
    if line is None or line.level < level:
        return
    for text in line.text.split("\n"):
        offset = (happened.log_time - started_ns) / 1e9
        say(f"{offset:10.3f} [{line.source}] {printable(text, colour=False)}")


def _line(happened: Happened) -> Line | None:
    event = happened.event
    if isinstance(event, ComponentEvent):
        # The state that follows from it says the rest.
        if event.kind is not ComponentEventKind.CRASHED or not event.backtrace:
            return None
        frames = "\n".join(f"  {frame}" for frame in event.backtrace)
        return Line(event.stamp_ns, event.full_node_name, f"backtrace:\n{frames}", ERROR)
    return line_of(event, happened.before, happened.after)
