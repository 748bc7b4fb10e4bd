"""What a page shows of a session: its timeline, lines of output, usage and rates."""

from __future__ import annotations

import struct
from array import array
from enum import IntEnum
from functools import cache
from itertools import accumulate
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from play_launch.container.cdr.messages import SYSTEM_STATS, read_log
from play_launch.container.cdr.structure import CdrError
from play_launch.postmortem.critical_chain import critical_chain, nodes_of_bring_up
from play_launch.postmortem.mcap_records import LATEST, MESSAGE, RECORD, EqualReader, Runs, Taken
from play_launch.postmortem.report.log_lines import Lines
from play_launch.postmortem.report.page import shown
from play_launch.postmortem.report.series import Rates, Usage
from play_launch.postmortem.units import NO_UNIT, Unit
from play_launch.recording import topics
from play_launch.recording.console_format import ERROR, INFO
from play_launch.recording.log_handler import REPORTED_LOGGER
from play_launch.supervisor.events import (
    ContainerState,
    LogRecord,
    NodeState,
    ProcessEventKind,
    SubjectKind,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from play_launch.postmortem.bag_reader import ChannelInfo, Message, RecordedTopic, Take
    from play_launch.postmortem.mcap_records import ChannelSequence
    from play_launch.postmortem.timeline import Timeline
    from play_launch.postmortem.units import FailureEvent, State
    from play_launch.supervisor.events import RunEvent

_USED: Final = struct.Struct("<15xQ8x28xd8xQB")
"""The record of a ProcessStats: log time, percent of a core, bytes, and what they count."""
_MANY: Final = 500
"""Samples of a unit that are drawn at once."""
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


class Gathered:
    """Reads a recording, and draws its timeline when that is whole."""

    def __init__(self, timeline: Timeline) -> None:
        self.timeline = timeline
        self.lines, self.usage, self.rates = Lines(timeline), Usage(), Rates()
        self.end = 0.0
        self.started_ns = 0
        self._marked = 0
        self._samples = EqualReader()
        self._sequence: ChannelSequence | None = None
        self._used: list[tuple[Any, ...]] = []
        """Samples of that sequence that are not drawn yet."""
        self._rows: dict[RecordedTopic, int] = {}
        """Of the topics that have samples."""

    def read(self) -> None:
        """Read the recording.

        Raises:
            NotARecordingError: At once, for another kind of file.
        """
        self.timeline.read(self._take_of)
        self._draw_samples()
        self.lines.prune()
        self.usage.finish()

    def _take_of(self, topic: RecordedTopic) -> Take | Runs:
        """Give what takes the messages of a topic: first the timeline does, then the page."""
        fold = self.timeline.take_of(topic)
        if topic.type_name == topics.PROCESS_STATS:
            unit = self.timeline.of_topic(topic)
            self._rows[topic] = NO_UNIT if unit is None else unit.number
            return Runs(self._take_samples)
        if topic.name == topics.OUTPUT.name:
            return Runs(self._take_lines)
        assert not isinstance(fold, Runs)

        def take(message: Message) -> None:
            event = fold(message) if fold is not None else None
            at = self._at_now(message.log_time)
            self.rates.add(topic.name, at)
            if topic.name == topics.SYSTEM.name:
                self._draw_machine(message.data, at)
            else:
                self._draw_event(event, at)

        return take

    def _take_samples(self, data: bytes, begin: int, channels: Mapping[int, ChannelInfo]) -> Taken:
        found = self._samples.read(data, begin, channels)
        self.timeline.samples.add(found)
        sequence = found.sequence
        if sequence.stride >= _USED.size:
            self.rates.add(_STATS, self._at_now(found.latest), len(sequence.channels))
            # Many at once: most messages of a long session are samples.
            if sequence is not self._sequence or len(self._used) >= _MANY:
                self._draw_samples()
                self._sequence = sequence
            self._used.append(
                _used_by(len(sequence.channels), sequence.stride).unpack(found.records)
            )
        return Taken(begin + len(found.records), found.latest)

    def _draw_samples(self) -> None:
        if self._sequence is None:
            return
        sequence, begin = self._sequence, self.started_ns
        # One by one where a unit occurs twice.
        is_each_once = len(set(map(id, sequence.channels))) == len(sequence.channels)
        times: tuple[int, ...] = ()
        ats: Sequence[float] = ()
        for used in (self._used,) if is_each_once else ([each] for each in self._used):
            columns = zip(*used, strict=True)
            for channel in sequence.channels:
                now, cpu, memory, kind = (next(columns) for _ in range(4))
                if now != times:
                    times = now
                    ats = [max(0.0, (min(at, LATEST) - begin) / 1e6) for at in accumulate(now, max)]
                self.usage.process(self._rows[channel.topic], kind[-1], ats, cpu, memory)
        self._used.clear()

    def _take_lines(self, data: bytes, begin: int, channels: Mapping[int, ChannelInfo]) -> Taken:
        taken = self.timeline.lines.take(data, begin, channels)
        latest, count = self._at_now(taken.latest), 0
        while begin < taken.end:
            _, length, _, _, log_time, _ = MESSAGE.unpack_from(data, begin)
            text_at, begin = begin + MESSAGE.size, begin + RECORD.size + length
            count += 1
            try:
                self.lines.output(min(self.at(log_time), latest), read_log(data[text_at:begin]))
            except CdrError as error:
                self.timeline.session.reader.damaged(str(error))
        self.rates.add(topics.OUTPUT.name, latest, count)
        return taken

    def _at_now(self, log_time: int) -> float:
        # What stands at the head of the file is known by now.
        self.started_ns = self.started_ns or self.timeline.session.started_ns
        at = self.at(log_time)
        self.end = max(self.end, at)
        return at

    def _draw_machine(self, data: bytes, at: float) -> None:
        try:
            self.usage.machine(at, SYSTEM_STATS.read(data))
        except CdrError as error:
            self.timeline.session.reader.damaged(str(error))

    def _draw_event(self, event: RunEvent | None, at: float) -> None:
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

    def chain(self) -> tuple[str, ...]:
        """Give what the first of the arrivals waited for, unit by unit, back to the start."""
        if not (arrivals := self.arrivals()):
            return ()
        links = critical_chain(self.timeline, self.timeline.units[arrivals[0].row])
        return tuple(shown(link.text(self.started_ns)) for link in links)

    def _arrivals(self) -> list[Arrival]:
        return [*map(self._arrival, nodes_of_bring_up(self.timeline))]

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


@cache
def _used_by(count: int, stride: int) -> struct.Struct:
    """Unpack the records of so many samples."""
    rest = stride - _USED.size
    return struct.Struct("<" + f"{_USED.format.removeprefix('<')}{rest}x" * count)


def _shown(state: State) -> Shown:
    if isinstance(state, ProcessEventKind):
        return _OF_PROCESS[state]
    return _OF_CONTAINER[state] if isinstance(state, ContainerState) else _OF_NODE[state]


def _add(lanes: Lanes, unit: Unit, shown: Shown, begin: float, end: float) -> None:
    lanes.rows.append(unit.number)
    lanes.states.append(shown)
    lanes.begins.append(begin)
    lanes.ends.append(max(begin, end))
