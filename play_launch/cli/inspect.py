"""What happened in a session, line by line."""

from __future__ import annotations

import sys
from collections import deque
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Annotated, Final, NamedTuple

import msgspec
import typer

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.explain import change
from play_launch.cli.info import report_damage
from play_launch.cli.output import clock_times, fail, printable, redirect_to_devnull
from play_launch.cli.show.display import encode
from play_launch.cli.show.event_lines import DisplayLine, line_of
from play_launch.config.values import parse_duration
from play_launch.control.event_words import event_object, names_of
from play_launch.postmortem import diagnostics
from play_launch.postmortem.bag_reader import BagReader
from play_launch.postmortem.diagnostics import Diagnostics, level_name
from play_launch.postmortem.events import UnreadableEventError
from play_launch.postmortem.parameters import TOPICS as PARAMETER_TOPICS
from play_launch.postmortem.parameters import Parameters, RecordedParameter, shortened
from play_launch.postmortem.past_session import PastSession
from play_launch.recording import topics
from play_launch.recording.console_format import DEBUG, ERROR, INFO, WARN
from play_launch.supervisor.events import ComponentEvent, ComponentEventKind
from play_launch.supervisor.view import SystemView

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from play_launch.postmortem.bag_reader import Message
    from play_launch.postmortem.diagnostics import LevelChange
    from play_launch.supervisor.events import RunEvent

_AROUND: Final = 5.0
"""Seconds on either side of a moment."""
_LEVELS: Final = {diagnostics.OK: INFO, diagnostics.ERROR: ERROR}
_TOPICS: Final = frozenset(topic.name for topic in topics.ALL_TOPICS)
"""Samples are no events to be read one by one."""


def inspect(  # noqa: PLR0917 - options, by name
    file: options.Recording,
    node: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Only this node, container or process; * and ? are patterns. May be repeated.",
            show_default=False,
        ),
    ] = None,
    level: Annotated[
        options.Level, typer.Option(help="Only events and lines of this level and above.")
    ] = "info",
    since: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="From this time on: after the start (12.5s, 2min), or of the day (14:03:07).",
            show_default=False,
        ),
    ] = None,
    until: Annotated[
        str | None, typer.Option(metavar="TIME", help="Up to this time.", show_default=False)
    ] = None,
    around: Annotated[
        str | None,
        typer.Option(
            metavar="TIME", help="Five seconds before and after this time.", show_default=False
        ),
    ] = None,
    as_json: options.Json = False,
) -> int:
    """Print the events of a recording: starts, loads, crashes, restarts, output and log.

    Changes of parameters and of levels on /diagnostics are included, and with --level debug all
    values of parameters that nodes reported. Times are seconds after the start. --json prints one
    object a line, as replay --json.

    Damaged and unfinished recordings (.active) are read as far as possible; exits with 5 then, with
    2 if the file is not a recording.
    """
    least = options.LEVELS[level]
    if around is not None and (since, until) != (None, None):
        fail("--around cannot be combined with --since and --until")
    session = PastSession(file)
    story = _Story(session)
    window: tuple[float, float] | None = None
    try:
        for message in session.reader.messages(_TOPICS | PARAMETER_TOPICS | {diagnostics.TOPIC}):
            window = window or _window(session, since, until, around)
            for each in story.take(message):
                if window[0] <= each.at_ns <= window[1] and _concerns(each.names, node or ()):
                    seconds = (each.at_ns - session.started_ns) / 1e9
                    for text in _texts(each, seconds, least, as_json=as_json):
                        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader has seen enough (`| head`); the rest of the file need not be read.
        redirect_to_devnull(sys.stdout)
        return ExitCode.OK
    return ExitCode.DAMAGED if report_damage(session.reader) else 0


def _window(
    session: PastSession, since: str | None, until: str | None, around: str | None
) -> tuple[float, float]:
    started_ns = session.started_ns
    if around is not None:
        earliest = started_ns - _AROUND * 1e9
        middle = _not_before(earliest, _moments("--around", around, started_ns))
        return middle - _AROUND * 1e9, middle + _AROUND * 1e9
    begin, end = float("-inf"), float("inf")
    if since is not None:
        moments = _moments("--since", since, started_ns)
        begin = _not_before(started_ns, moments)
        if begin > moments[0] and begin == moments[-1] and begin > _end(session.reader.path):
            begin = moments[0]  # the recording was over the next time that the clock was there
    if until is not None:
        end = _not_before(started_ns, _moments("--until", until, started_ns))
    return begin, end


def _moments(option: str, text: str, started_ns: int) -> list[float]:
    """List what a time may mean, the earliest first: a clock is there each day."""
    if times := clock_times(text, started_ns / 1e9):
        return [1e9 * each for each in times]
    try:
        return [started_ns + parse_duration(text) * 1e9]
    except ValueError as error:
        fail(f"{option} {text}: {error}")


def _not_before(earliest: float, moments: list[float]) -> float:
    return next(each for each in moments if each >= earliest)


def _end(file: Path) -> int:
    reader = BagReader(file)
    deque(reader.messages(()), maxlen=0)
    return reader.end


class _Told(NamedTuple):
    """What is told of one event."""

    at_ns: int
    names: Sequence[str]
    line: DisplayLine | None
    values: dict[str, object]


class _Story:
    """What the messages of a recording tell, one after the other."""

    def __init__(self, session: PastSession) -> None:
        self._session = session
        self._parameters = Parameters()
        self._diagnostics = Diagnostics(session)
        self._view = SystemView()

    def take(self, message: Message) -> Iterator[_Told]:
        at_ns, topic = message.log_time, message.topic.name
        yield from map(_of_level, self._diagnostics.fell_silent(at_ns))
        try:
            if topic == diagnostics.TOPIC:
                yield from map(_of_level, self._diagnostics.take(message))
            elif topic not in PARAMETER_TOPICS:
                yield from self._of_event(message)
            elif said := self._parameters.take(message):
                yield _Told(at_ns, [said.node], *_of_parameters(said, at_ns))
        except UnreadableEventError as error:
            self._session.reader.damaged(str(error))

    def _of_event(self, message: Message) -> Iterator[_Told]:
        event = self._session.event(message)
        if event is not None:
            before, self._view = self._view, self._view.after(event)
            line = _line(event, before, self._view)
            yield _Told(message.log_time, names_of(event), line, event_object(event))


def _concerns(names: Sequence[str], patterns: Sequence[str]) -> bool:
    return not patterns or any(fnmatchcase(name, pattern) for name in names for pattern in patterns)


def _texts(told: _Told, since: float, level: int, *, as_json: bool) -> Iterator[str]:
    line = told.line
    if as_json:
        if line is None or line.level >= level:
            yield encode(told.values)
    elif line is not None and line.level >= level:
        for text in line.text.split("\n"):
            yield f"{since:10.3f} [{line.source}] {printable(text)}"


def _of_level(change: LevelChange) -> _Told:
    level = _LEVELS.get(change.level, WARN)
    line = DisplayLine(change.at_ns, change.status, str(change), level)
    values: dict[str, object] = {
        "event": "diagnostics",
        "stamp_ns": change.at_ns,
        "status": change.status,
        "hardware_id": change.hardware,
        "level": level_name(change.level),
        "message": change.message,
    }
    return _Told(change.at_ns, [change.status], line, values)


def _of_parameters(said: RecordedParameter, log_time: int) -> tuple[DisplayLine, dict[str, object]]:
    values: dict[str, object] = {"event": "parameters", "stamp_ns": log_time}
    values |= msgspec.to_builtins(said._asdict())
    if said.error:
        return DisplayLine(log_time, said.node, f"parameters: {said.error}", DEBUG), values
    if said.values is None:
        text = "\n".join(change(each) for each in said.changes)
        return DisplayLine(log_time, said.node, text), values
    answer = "\n".join(f"  {name} {shortened(value)}" for name, value in said.values.items())
    return DisplayLine(log_time, said.node, f"parameters:\n{answer}", DEBUG), values


def _line(event: RunEvent, before: SystemView, after: SystemView) -> DisplayLine | None:
    if isinstance(event, ComponentEvent):
        # The state that follows from it says the rest.
        if event.kind is not ComponentEventKind.CRASHED or not event.backtrace:
            return None
        frames = "\n".join(f"  {frame}" for frame in event.backtrace)
        return DisplayLine(event.stamp_ns, event.full_node_name, f"backtrace:\n{frames}", ERROR)
    return line_of(event, before, after)
