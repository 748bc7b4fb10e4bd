"""A session as a trace that Perfetto and ``chrome://tracing`` open.

The format is the JSON of the Trace Event Format: "complete" events (X) are slices, "instant" ones
(i) are marks, "counter" ones (C) are curves, "metadata" (M) names the tracks. Each container is a
process of the trace, with a track for each of its nodes; an ordinary process has one to itself.
Times are microseconds since the beginning of the session.
"""

from __future__ import annotations

import json
import math
from typing import IO, TYPE_CHECKING, Any, Final

from msgspec import Struct

from play_launch.config.node_key import NodeKey
from play_launch.postmortem.mcap_records import Runs
from play_launch.recording.console_format import ERROR, WARN, line_level
from play_launch.supervisor.events import (
    ContainerState,
    ContainerStateChanged,
    GroupSample,
    LogRecord,
    MemoryKind,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    ProcessSample,
    SubjectKind,
    SystemSample,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.postmortem.bag_reader import Message, RecordedTopic, Take
    from play_launch.postmortem.timeline import Timeline
    from play_launch.postmortem.units import FailureEvent
    from play_launch.supervisor.events import RunEvent

    TraceEvent = dict[str, Any]

_MEGABYTE: Final = 1e6
_LONGEST_NAME: Final = 120
_MACHINE: Final = "machine"
_SUPERVISOR: Final = "play-launch"
_NOT_THERE: Final = frozenset(
    {
        NodeState.PENDING,
        NodeState.UNLOADED,
        ContainerState.STOPPED,
        ProcessEventKind.EXITED,
    }
)
"""States in which a track is empty."""


class Track(Struct, frozen=True):
    """Where events are drawn: a process and a thread of the trace."""

    process: int
    thread: int


class TraceMaker:
    """Writes the events of the trace while the timeline takes those of the session."""

    def __init__(self, timeline: Timeline, file: IO[str]) -> None:
        self._timeline, self._file = timeline, file
        self._separator = "\n"
        self._started_ns: int | None = None
        """Where times begin: the first message comes after the one that tells it."""
        self._marked = 0
        self._processes: dict[str, int] = {}
        self._tracks: dict[tuple[str, str], Track] = {}
        self._open: dict[Track, TraceEvent] = {}
        """Slices without their durations."""
        self._counters: dict[tuple[int, str], Mapping[str, float]] = {}

    def take_of(self, topic: RecordedTopic) -> Take:
        """Give what takes the messages of a topic: the timeline, then the trace."""
        fold = self._timeline.take_of(topic)

        def take(message: Message) -> None:
            # Samples of processes lead to no failure.
            event = None if fold is None or isinstance(fold, Runs) else fold(message)
            event = event or self._timeline.session.event(message)
            if event is not None:
                self._add(self._time(message.log_time), event)
            failures = self._timeline.events[self._marked :]
            self._marked += len(failures)
            for failure in failures:
                self._failed(failure)

        return take

    def end(self, end_ns: int) -> None:
        """Write the slices that are still open."""
        for track in list(self._open):
            self._close(track, self._time(end_ns))

    def _write(self, event: TraceEvent) -> None:
        self._file.write(self._separator)
        self._file.write(json.dumps(event, separators=(",", ":"), allow_nan=False))
        self._separator = ",\n"

    def _add(self, at: float, event: RunEvent) -> None:
        match event:
            case NodeStateChanged():
                args: TraceEvent = {"pid": event.pid, "attempt": event.attempt}
                track = self._track(event.container, event.node)
                self._state(track, at, event.state, {"reason": event.reason, **args})
            case ContainerStateChanged():
                track = self._track(event.container, "container")
                args = {"reason": event.reason, "mechanism": event.mechanism}
                self._state(track, at, event.state, args)
            case ProcessEvent():
                args = {"reason": event.message, "pid": event.pid}
                self._state(self._track(event.name, "process"), at, event.kind, args)
            case ProcessSample():
                self._process_sample(at, event)
            case GroupSample():
                self._group_sample(at, event)
            case SystemSample():
                self._system_sample(at, event)
            case LogRecord() if event.level >= WARN:
                args = {"logger": event.name, "message": event.message}
                self._mark(self._track(_SUPERVISOR, "log"), at, event.message, args)
            case OutputLine() if line_level(event) >= ERROR:
                args = {"text": event.text, "pid": event.pid}
                self._mark(self._track(event.process, "output"), at, event.text, args)
            case _:
                pass

    def _failed(self, failure: FailureEvent) -> None:
        unit = failure.unit
        track = (
            self._track(unit.container, unit.name)
            if unit.container
            else self._track(unit.name, "process")
        )
        if failure.what:
            args = {"reason": failure.reason, "backtrace": "\n".join(failure.frames)}
            self._mark(track, self._time(failure.at_ns), failure.what, args)

    def _state(
        self,
        track: Track,
        at: float,
        state: NodeState | ContainerState | ProcessEventKind,
        args: TraceEvent,
    ) -> None:
        name = state.name.lower().replace("_", " ")
        before = self._open.get(track)
        if before is not None and before["name"] == name:
            return  # reported again
        self._close(track, at)
        if state not in _NOT_THERE:
            place = {"pid": track.process, "tid": track.thread, "ts": at}
            self._open[track] = {"ph": "X", "cat": "state", "name": name, **place, "args": args}

    def _close(self, track: Track, at: float) -> None:
        ended = self._open.pop(track, None)
        if ended is not None:
            self._write(ended | {"dur": round(max(0.0, at - ended["ts"]), 3)})

    def _mark(self, track: Track, at: float, name: str, args: TraceEvent) -> None:
        self._write(
            {
                "ph": "i",
                "s": "t",
                "cat": "mark",
                "name": name[:_LONGEST_NAME] or "(empty)",
                "pid": track.process,
                "tid": track.thread,
                "ts": at,
                "args": args,
            }
        )

    def _process_sample(self, at: float, sample: ProcessSample) -> None:
        process, name = self._owner(sample)
        self._count(process, at, f"cpu {name}", {"percent": sample.cpu_percent})
        if sample.memory_kind is not MemoryKind.SHARED:
            self._count(process, at, f"memory {name}", {"MB": sample.memory_bytes / _MEGABYTE})
            self._count(process, at, f"descriptors {name}", {"count": sample.descriptors})
        self._count(process, at, f"threads {name}", {"count": sample.threads})

    def _group_sample(self, at: float, sample: GroupSample) -> None:
        process, name = self._owner(sample)
        if sample.throttled_periods:
            self._count(process, at, f"throttled {name}", {"s": sample.throttled_seconds})
        self._count(process, at, f"pressure cpu {name}", {"some percent": sample.cpu_pressure})

    def _owner(self, sample: ProcessSample | GroupSample) -> tuple[int, str]:
        """Give where a sample is shown, and under which name."""
        if sample.kind is not SubjectKind.NODE:
            return self._process(sample.key), sample.key
        key = NodeKey.parsed(sample.key)
        return self._process(key.container), key.name

    def _system_sample(self, at: float, sample: SystemSample) -> None:
        process = self._process(_MACHINE)
        used = sample.memory_total - sample.memory_available
        for name, values in (
            ("cpu", {"percent": sample.cpu_percent}),
            ("memory used", {"MB": used / _MEGABYTE}),
            ("shared memory used", {"MB": sample.shm_used / _MEGABYTE}),
            ("disk free", {"MB": sample.disk_free / _MEGABYTE}),
            ("load", {"1 min": sample.load_1}),
            ("pressure cpu", {"some percent": sample.cpu_some_avg10}),
            ("pressure memory", {"some percent": sample.memory_some_avg10}),
            ("pressure io", {"some percent": sample.io_some_avg10}),
        ):
            self._count(process, at, name, values)

    def _count(self, process: int, at: float, name: str, values: Mapping[str, float]) -> None:
        rounded = {key: round(value, 1) for key, value in values.items() if math.isfinite(value)}
        # A curve holds its value until the next.
        if not rounded or self._counters.get((process, name)) == rounded:
            return
        self._counters[process, name] = rounded
        self._write({"ph": "C", "name": name, "pid": process, "tid": 0, "ts": at, "args": rounded})

    def _process(self, name: str) -> int:
        number = self._processes.get(name)
        if number is None:
            number = self._processes[name] = len(self._processes) + 1
            self._name("process", Track(number, 0), name)
        return number

    def _track(self, process_name: str, name: str) -> Track:
        track = self._tracks.get((process_name, name))
        if track is None:
            process = self._process(process_name)
            track = Track(process, len(self._tracks) + 1)
            self._tracks[process_name, name] = track
            self._name("thread", track, name)
        return track

    def _name(self, what: str, track: Track, name: str) -> None:
        where = {"ph": "M", "pid": track.process, "tid": track.thread}
        number = track.process if what == "process" else track.thread
        self._write({**where, "name": f"{what}_name", "args": {"name": name}})
        self._write({**where, "name": f"{what}_sort_index", "args": {"sort_index": number}})

    def _time(self, stamp_ns: int) -> float:
        if self._started_ns is None:
            self._started_ns = self._timeline.session.started_ns
        return max(0, stamp_ns - self._started_ns) / 1000


def write_trace(timeline: Timeline, file: IO[str]) -> None:
    """Read a session, and write its trace, one event a line.

    Raises:
        NotARecordingError: For another kind of file.
        OSError: When the file takes no more.
    """
    file.write('{"displayTimeUnit":"ms","traceEvents":[')
    maker = TraceMaker(timeline, file)
    timeline.read(maker.take_of)
    maker.end(timeline.session.reader.end)
    about = timeline.session.about
    described = {name: about[name] for name in ("name", "id", "started_ns") if name in about}
    file.write(f'\n],"otherData":{json.dumps(described)}}}\n')
