"""What a page shows of a session: its timeline, lines of output, usage and rates."""

from __future__ import annotations

import struct
from array import array
from enum import IntEnum
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.container.cdr.layout import CdrError
from play_launch.container.cdr.messages import SYSTEM_STATS, read_log
from play_launch.postmortem.events import UnreadableEventError
from play_launch.postmortem.records import Runs
from play_launch.postmortem.report.lines import Lines
from play_launch.postmortem.report.page import shown
from play_launch.postmortem.report.usage import Rates, Usage
from play_launch.postmortem.units import NO_UNIT, Unit
from play_launch.recording import topics
from play_launch.recording.console_format import ERROR, INFO
from play_launch.supervisor.events import (
    REPORTED_LOGGER,
    ContainerState,
    LogRecord,
    NodeState,
    ProcessEventKind,
    SubjectKind,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.postmortem.bag_reader import Message, RecordedTopic, Take
    from play_launch.postmortem.timeline import Timeline
    from play_launch.postmortem.units import FailureEvent, State

_USED: Final = struct.Struct("<15xQ8x28xd8xQB")
"""The record of a ProcessStats: log time, percent of a core, bytes, and what they count."""
_STATS: Final = "/play_launch/…/stats"
"""Stands for the topics that hold what one unit used each."""
_ARRIVALS: Final = 15
"""Nodes whose bring-up a page lists, the latest first."""
_RESULTS: Final = {NodeState.LOST: "lost its container", NodeState.LOAD_FAILED: "failed to load"}
"""How a node arrived, where the name of the state does not tell."""


class Shown(IntEnum):
    """How a state is drawn."""

    CONSTRUCTING = 0
    LOADED = 1
    """It is there: a container or a process runs."""
    CRASHED = 2
    """It failed, and is down."""
    AWAY = 3
    """It is down, and nothing is wrong with it."""


_OF_NODE: Final = {
    NodeState.PENDING: Shown.AWAY,
    NodeState.REQUESTED: Shown.CONSTRUCTING,
    NodeState.LOADING: Shown.CONSTRUCTING,
    NodeState.LOADED: Shown.LOADED,
    NodeState.LOAD_FAILED: Shown.CRASHED,
    NodeState.UNLOADING: Shown.AWAY,
    NodeState.UNLOADED: Shown.AWAY,
    NodeState.CRASHED: Shown.CRASHED,
    NodeState.GAVE_UP: Shown.CRASHED,
    NodeState.LOST: Shown.AWAY,
}
_OF_CONTAINER: Final = {
    ContainerState.STOPPED: Shown.AWAY,
    ContainerState.STARTING: Shown.CONSTRUCTING,
    ContainerState.RUNNING: Shown.LOADED,
    ContainerState.KILLING: Shown.CRASHED,
    ContainerState.BACKOFF: Shown.CRASHED,
    ContainerState.GAVE_UP: Shown.CRASHED,
    ContainerState.STOPPING: Shown.AWAY,
}
_OF_PROCESS: Final = {
    ProcessEventKind.STARTED: Shown.LOADED,
    ProcessEventKind.READY: Shown.LOADED,
    ProcessEventKind.EXITED: Shown.AWAY,
    ProcessEventKind.RESTARTING: Shown.CRASHED,
    ProcessEventKind.GAVE_UP: Shown.CRASHED,
    ProcessEventKind.STOPPING: Shown.AWAY,
    ProcessEventKind.WAITING: Shown.AWAY,
    ProcessEventKind.STOPPED: Shown.AWAY,
}


class PageRow(Struct, frozen=True):
    """One unit whose life the timeline shows."""

    kind: str
    """``node``, ``container`` or ``process``."""
    name: str
    container: str
    """Of a node; else empty."""


class Mark(Struct, frozen=True):
    """One failure; ``at`` is in milliseconds since the start."""

    row: int
    at: float
    what: str
    """``crashed``, ``failed to load``, ``died``, ``did not stop``, ``gave up``."""
    reason: str
    backtrace: tuple[str, ...] = ()


class Arrival(Struct, frozen=True):
    """How one node came up; times are milliseconds since the start, None where unknown."""

    row: int
    starting: float | None
    """When its container was started."""
    running: float | None
    """When its container was ready."""
    requested: float | None
    constructing: float | None
    end: float | None
    """When it was loaded, or failed."""
    result: str
    """``loaded``, ``crashed``, ...; empty: it never came up."""


class Lanes(Struct):
    """Stays of rows in states, from begin to end; times are milliseconds since the start."""

    rows: array[int]
    states: array[int]
    begins: array[float]
    ends: array[float]


class Gathered(Runs):
    """Reads a recording, and draws its timeline when that is whole."""

    def __init__(self, timeline: Timeline) -> None:
        self.timeline = timeline
        self.lines, self.usage, self.rates = Lines(timeline), Usage(), Rates()
        self.end = 0.0
        self.started_ns = 0
        self._marked = 0
        self._rows: dict[RecordedTopic, int] = {}
        """Of the topics that have samples."""

    def read(self) -> None:
        """Read the recording.

        Raises:
            NotARecordingError: At once, for another kind of file.
        """
        self.timeline.read(self._take_of)
        self.lines.prune()
        self.usage.finish()

    def _take_of(self, topic: RecordedTopic) -> Take | Runs:
        """Give what takes the messages of a topic: first the timeline does, then the page."""
        fold = self.timeline.runs_of(topic)
        if isinstance(fold, Runs):
            unit = self.timeline.of_topic(topic)
            self._rows[topic] = NO_UNIT if unit is None else unit.number
            return self
        draw: Callable[[Message, float, object], None] = self._draw_event
        if topic.name == topics.OUTPUT.name:
            draw = self._draw_line
        elif topic.name == topics.SYSTEM.name:
            draw = self._draw_machine

        def take(message: Message) -> None:
            event = fold(message) if fold is not None else None
            at = self._at_now(message.log_time)
            self.rates.add(topic.name, at)
            try:
                draw(message, at, event)
            except (CdrError, UnreadableEventError) as error:
                self.timeline.session.note_damage(message, error)

        return take

    def take_run(self, records: bytes, stride: int, topics: list[RecordedTopic]) -> None:
        """Take samples of processes."""
        self.timeline.samples.take_run(records, stride, topics)
        if stride < _USED.size:
            return
        latest = self.timeline.session.reader.end
        self.rates.add(_STATS, self._at_now(latest), len(topics))
        used = struct.Struct(f"{_USED.format}{stride - _USED.size}x")
        process, rows = self.usage.process, self._rows
        for topic, (log_time, cpu, memory, kind) in zip(
            topics, used.iter_unpack(records), strict=True
        ):
            # Most messages of a long session, so without further calls.
            at = max(0.0, (min(log_time, latest) - self.started_ns) / 1e6)
            process(rows[topic], at, cpu, memory, kind)

    def _at_now(self, log_time: int) -> float:
        # What stands at the head of the file is known by now.
        self.started_ns = self.started_ns or self.timeline.session.started_ns
        at = self.at(min(log_time, self.timeline.session.reader.end))
        self.end = max(self.end, at)
        return at

    def _draw_line(self, message: Message, at: float, _: object) -> None:
        self.lines.output(at, read_log(message.data))

    def _draw_machine(self, message: Message, at: float, _: object) -> None:
        self.usage.machine(at, SYSTEM_STATS.read(message.data))

    def _draw_event(self, _: Message, at: float, event: object) -> None:
        if isinstance(event, LogRecord) and event.level >= INFO and event.name != REPORTED_LOGGER:
            self.lines.add(at, NO_UNIT, event.level, event.message)
        for failure in self.timeline.events[self._marked :]:
            if (mark := self._mark(failure)) is not None:
                self.lines.failure(mark.at)
                self.lines.add(mark.at, mark.row, ERROR, f"{mark.what}: {mark.reason}")
        self._marked = len(self.timeline.events)

    def at(self, log_time: int) -> float:
        return max(0.0, (log_time - self.started_ns) / 1e6)

    def rows(self) -> tuple[PageRow, ...]:
        return tuple(
            PageRow(unit.kind.name.lower(), shown(unit.name), shown(unit.container))
            for unit in self.timeline.units[:NO_UNIT]
        )

    def marks(self) -> tuple[Mark, ...]:
        return tuple(filter(None, map(self._mark, self.timeline.events)))

    def _mark(self, event: FailureEvent) -> Mark | None:
        if not event.what:
            return None
        trace = tuple(map(shown, event.frames))
        return Mark(event.unit.number, self.at(event.at_ns), event.what, shown(event.reason), trace)

    def lanes(self) -> Lanes:
        """Draw the changes of state."""
        lanes = Lanes(array("H"), array("B"), array("d"), array("d"))
        for unit in self.timeline.units[:NO_UNIT]:
            before: tuple[Shown, float] | None = None
            for log_time, state, is_failure in unit.changes:
                now = Shown.CRASHED if is_failure else _shown(state)
                if before is not None and before[0] is now:
                    continue
                at = self.at(log_time)
                if before is not None:
                    _add(lanes, unit, *before, at)
                before = now, at
            if before is not None:
                _add(lanes, unit, *before, self.end)
        return lanes

    def came_up(self) -> float | None:
        """Give when the last node had arrived, well or not; None when one never did."""
        ends = [each.end for each in self._arrivals()]
        known = [end for end in ends if end is not None]
        return max(known) if known and len(known) == len(ends) else None

    def arrivals(self) -> tuple[Arrival, ...]:
        """Give the nodes for which the system waited longest, those that never came first."""
        never = float("inf")
        every = sorted(self._arrivals(), key=lambda one: -(never if one.end is None else one.end))
        return tuple(every[:_ARRIVALS])

    def _arrivals(self) -> list[Arrival]:
        return [
            self._arrival(unit)
            for unit in self.timeline.units
            if unit.kind is SubjectKind.NODE and unit.is_known
        ]

    def _arrival(self, unit: Unit) -> Arrival:
        container = self.timeline.unit(SubjectKind.CONTAINER, unit.container)
        began, ready, requested, constructing, end = (
            self.at(ns) if ns else None
            for ns in (
                container.begun_ns,
                container.ready_ns,
                unit.begun_ns,
                unit.constructing_ns,
                unit.ready_ns,
            )
        )
        state = unit.arrival
        result = "" if state is None else _RESULTS.get(state, state.value)
        return Arrival(unit.number, began, ready, requested, constructing, end, result)


def _shown(state: State) -> Shown:
    if isinstance(state, ProcessEventKind):
        return _OF_PROCESS[state]
    return _OF_CONTAINER[state] if isinstance(state, ContainerState) else _OF_NODE[state]


def _add(lanes: Lanes, unit: Unit, shown: Shown, begin: float, end: float) -> None:
    lanes.rows.append(unit.number)
    lanes.states.append(shown)
    lanes.begins.append(begin)
    lanes.ends.append(max(begin, end))
