"""Everything that a page shows, gathered in one pass over a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec import Struct, field

from play_launch.container.cdr.layout import CdrError
from play_launch.container.cdr.messages import PROCESS_STATS
from play_launch.postmortem.events import UnreadableEventError, event_of
from play_launch.postmortem.report.bring_up import BringUp
from play_launch.postmortem.report.lanes import OF_CONTAINER, OF_NODE, OF_PROCESS, Lanes, Shown
from play_launch.postmortem.report.lines import Lines
from play_launch.postmortem.report.marks import DEAF, Mark, Marks
from play_launch.postmortem.report.rates import Rates
from play_launch.postmortem.report.rows import Rows
from play_launch.postmortem.report.usage import Usage
from play_launch.recording import topics
from play_launch.recording.console_format import ERROR, INFO
from play_launch.supervisor.events import (
    REPORTED_LOGGER,
    ComponentEvent,
    ContainerStateChanged,
    LogRecord,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    SubjectKind,
    SystemSample,
)

if TYPE_CHECKING:
    from play_launch.postmortem.bag_reader import Message, RecordedTopic
    from play_launch.postmortem.session import PastSession
    from play_launch.supervisor.events import RunEvent

_USED = PROCESS_STATS.picker("cpu_percent", "memory_bytes", "memory_kind")
_STATS = "/play_launch/…/stats"
"""Stands for the topics that hold what one thing used each."""


class Gathered(Struct):
    """What is known after the pass; times are milliseconds since the start."""

    rows: Rows = field(default_factory=Rows)
    lanes: Lanes = field(default_factory=Lanes)
    marks: Marks = field(default_factory=Marks)
    lines: Lines = field(default_factory=Lines)
    usage: Usage = field(default_factory=Usage)
    rates: Rates = field(default_factory=Rates)
    bring_up: BringUp = field(default_factory=BringUp)
    end: float = 0.0

    def take(self, at: float, event: RunEvent) -> None:
        """Take one event."""
        match event:
            case OutputLine():
                self.lines.output(at, event, self.rows)
            case SystemSample():
                self.usage.machine(at, event)
            case LogRecord():
                if event.level >= INFO and event.name != REPORTED_LOGGER:
                    self.lines.log(at, event)
            case ComponentEvent():
                self.marks.component(event)
            case NodeStateChanged():
                row = self.rows.number(SubjectKind.NODE, str(event.key))
                self.lanes.change(row, at, OF_NODE[event.state])
                self.bring_up.node(row, at, event)
                self._failed(self.marks.node(row, at, event))
            case ContainerStateChanged():
                row = self.rows.number(SubjectKind.CONTAINER, event.container)
                self.lanes.change(row, at, OF_CONTAINER[event.state])
                self.bring_up.container(at, event)
            case ProcessEvent():
                row = self.rows.of_name(event.name)
                mark = self.marks.process(row, at, event)
                if not self.rows.is_container(row):
                    is_wanted = mark is None or mark.what == DEAF
                    shown = OF_PROCESS[event.kind] if is_wanted else Shown.CRASHED
                    self.lanes.change(row, at, shown)
                self._failed(mark)
            case _:
                pass

    def _failed(self, mark: Mark | None) -> None:
        if mark is not None:
            self.lines.failure(mark.at)
            self.lines.add(mark.at, mark.row, ERROR, f"{mark.what}: {mark.reason}")


class _Stream(Struct):
    """What is known about the messages of one topic."""

    name: str
    """Under which they are counted."""
    row: int | None = None
    """Of the timeline, if they are samples of one thing."""


class Gathering:
    """The state of a pass over a recording."""

    def __init__(self, session: PastSession) -> None:
        """Take nothing yet."""
        self._session = session
        self._gathered = Gathered()
        self._streams: dict[RecordedTopic, _Stream] = {}
        self._started: int | None = None

    def take(self, message: Message) -> None:
        """Take the next message, of whatever topic."""
        gathered = self._gathered
        if self._started is None:
            # What stands at the head of the file is known by now.
            self._started = self._session.started_ns
        at = max(0.0, (message.log_time - self._started) / 1e6)
        gathered.end = max(gathered.end, at)
        stream = self._streams.get(message.topic)
        if stream is None:
            stream = self._streams[message.topic] = _stream(message.topic, gathered.rows)
        gathered.rates.add(stream.name, at)
        try:
            if stream.row is not None:
                # Most messages of a long session: they are read without becoming events.
                gathered.usage.process(stream.row, at, *_USED(message.data))
            elif (event := event_of(message)) is not None:
                gathered.take(at, event)
        except (CdrError, UnreadableEventError) as error:
            self._session.note_damage(message, error)

    def finish(self) -> Gathered:
        """Give everything; no message comes any more."""
        gathered = self._gathered
        gathered.lanes.end(gathered.end)
        gathered.lines.prune()
        gathered.usage.finish()
        return gathered


def _stream(topic: RecordedTopic, rows: Rows) -> _Stream:
    if topic.type_name != topics.PROCESS_STATS or topic.kind.upper() not in SubjectKind.__members__:
        return _Stream(topic.name)
    return _Stream(_STATS, rows.number(SubjectKind[topic.kind.upper()], topic.key))
