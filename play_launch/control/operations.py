"""Operations of the control socket on a running system."""

from __future__ import annotations

import asyncio
from collections import Counter, defaultdict
from functools import partial
from typing import TYPE_CHECKING, Any

from msgspec import Struct
from msgspec.structs import replace

from play_launch.container.cdr.messages import NODE_PARAMETERS
from play_launch.container.cdr.structure import CdrError
from play_launch.control.actions import ActionLog, Actions
from play_launch.control.coordinated import Coordinated, Lease, MeetRequest
from play_launch.control.feed import KINDS, ClientQueue, Selection, line_of, message_of
from play_launch.control.messages import (
    ActionRequest,
    ChangeRequest,
    EventsRequest,
    LastLine,
    ParameterNames,
    RecordingResult,
    RestartRecord,
    Selected,
    SignalRequest,
    SnapshotResult,
    SystemResult,
    UnitRow,
    UnitStatus,
    WaitRequest,
    read_arguments,
)
from play_launch.control.protocol import (
    MEMBER_ACTIONS,
    NODE_ACTIONS,
    ROS_VARIABLES,
    Code,
    OperationError,
)
from play_launch.control.units import (
    full_name,
    guests_of,
    meant,
    members_of,
    nodes_of,
    rows_of,
    status_of,
    target_of,
    with_groups,
)
from play_launch.recording import topics
from play_launch.recording.topic_recorder import SnapshotError
from play_launch.supervisor.events import (
    ContainerStateChanged,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    ProcessSample,
)
from play_launch.supervisor.outcome import Cause
from play_launch.supervisor.view import is_up

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence

    from play_launch.config.model import ReplayConfig
    from play_launch.control.feed import Feed, Numbered
    from play_launch.control.messages import Caller, Request
    from play_launch.control.units import Samples, Target
    from play_launch.recording.recorder import Recorder
    from play_launch.recording.topic_recorder import Snapshots
    from play_launch.runtime.publisher import Publisher
    from play_launch.runtime.system import System
    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.expectations import Expectations
    from play_launch.supervisor.view import SystemView

_SHOWN: int = 10
"""Restarts and lines of output in a status."""
_RESTARTS = frozenset(
    {ProcessEventKind.EXITED, ProcessEventKind.RESTARTING, ProcessEventKind.GAVE_UP}
)
_CHANGES = (ContainerStateChanged, NodeStateChanged, ProcessEvent)
_EXPECTED = frozenset({Cause.NONE, Cause.STOPPED, Cause.STOP_TIMEOUT})
"""Of ends that count as no failure."""
_CRASHES = frozenset({NodeState.CRASHED, NodeState.LOST, NodeState.LOAD_FAILED, NodeState.GAVE_UP})


class Nothing(Struct, frozen=True):
    """Arguments of an operation that has none."""


class Operations:
    """Operations on one session. Belongs to the thread of the event loop."""

    def __init__(
        self,
        system: System,
        publisher: Publisher,
        feed: Feed,
        *,
        snapshots: Snapshots,
        expectations: Expectations,
        environment: Mapping[str, str],
        recorder: Recorder,
        log: ActionLog,
        apply: Callable[[ChangeRequest, Caller], Awaitable[object]],
    ) -> None:
        self._environment = {
            name: value for name, value in environment.items() if name.startswith(ROS_VARIABLES)
        }
        self._system = system
        self._publisher = publisher
        self._feed = feed
        self._snapshots = snapshots
        self._expectations = expectations
        self._recorder = recorder
        self._samples: Samples = {}
        self._causes: defaultdict[Target, Counter[str]] = defaultdict(Counter)
        recent = [each.event for each in feed.recent()]
        self._began_ns = recent[0].stamp_ns if recent else recorder.clock.now()
        self._up_after: float | None = None
        for event in recent:
            self._count(event)
        changes = [event for event in recent if isinstance(event, _CHANGES)]
        if changes:
            self._note_when_up(changes[-1], publisher.view)
        self._log = log
        coordinated = Coordinated(system, recorder.clock.now)
        actions = Actions(system, publisher, feed, log, expectations)
        self._table: dict[str, tuple[type[Struct], Callable[[Any, Caller], Awaitable[object]]]] = {
            "ps": (Selected, self._ps),
            "status": (Selected, self._status),
            "events": (EventsRequest, self._events),
            "parameters": (Selected, self._parameters),
            "environment": (Nothing, self._give_environment),
            "wait": (WaitRequest, actions.wait),
            **{
                action: (ActionRequest, partial(actions.act, action))
                for action in (*MEMBER_ACTIONS, *NODE_ACTIONS)
            },
            "signal": (SignalRequest, partial(actions.act, "signal")),
            "snapshot": (Nothing, self._snapshot),
            "expectations": (Nothing, self._give_expectations),
            "recording": (Nothing, self._give_recording),
            "system": (Nothing, self._give_system),
            "apply": (ChangeRequest, apply),
            "clock": (Nothing, coordinated.clock),
            "meet": (MeetRequest, coordinated.meet),
            "conditions": (Nothing, coordinated.conditions),
            "lease": (Lease, coordinated.lease),
            "end": (Nothing, coordinated.end),
        }
        publisher.add_sink(self)
        publisher.add_sink(coordinated)

    async def __call__(self, request: Request, caller: Caller) -> object:
        if request.op not in self._table:
            known = ", ".join(sorted(self._table))
            text = f"unknown operation {request.op!r:.80}; there are: {known}"
            raise OperationError(Code.UNKNOWN_OPERATION, text)
        kind, operation = self._table[request.op]
        return await operation(read_arguments(request.arguments, kind), caller)

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:  # noqa: ARG002 - a sink
        if isinstance(event, ProcessSample):
            self._samples[event.kind, event.key] = event
        elif isinstance(event, _CHANGES):
            self._count(event)
            self._note_when_up(event, after)

    def _count(self, event: RunEvent) -> None:
        match event:
            case NodeStateChanged(state=NodeState.CRASHED):
                target: Target = event.key
            case ProcessEvent(kind=ProcessEventKind.EXITED):
                target = event.name
            case _:
                return
        if event.cause not in _EXPECTED:
            self._causes[target][event.cause.name.lower().replace("_", " ")] += 1

    def _note_when_up(self, event: RunEvent, view: SystemView) -> None:
        if self._up_after is None and is_up(view):
            self._up_after = round((event.stamp_ns - self._began_ns) / 1e9, 3)

    async def _ps(self, request: Selected, _caller: Caller) -> list[UnitRow]:
        view = self._publisher.view
        rows = rows_of(view, self._system.processes, self._samples)
        if request.names:
            found = set(self._chosen(request.names))
            rows = [row for row in rows if target_of(row) in found]
        rows = [replace(row, causes=dict(self._causes.get(target_of(row), {}))) for row in rows]
        return await asyncio.to_thread(with_groups, rows)

    async def _status(self, request: Selected, caller: Caller) -> list[UnitStatus]:
        rows = await self._ps(request, caller)
        recent = [each.event for each in self._feed.recent()]
        found = [
            status_of(
                row,
                self._system.world,
                self._publisher.view,
                tuple(_restarts_of(target_of(row), recent))[-_SHOWN:],
                tuple(_output_of(target_of(row), recent))[-_SHOWN:],
            )
            for row in rows
        ]
        return [each for each in found if each is not None]

    async def _give_expectations(self, _request: Nothing, _caller: Caller) -> object:
        return self._expectations.states

    async def _give_recording(self, _request: Nothing, _caller: Caller) -> RecordingResult:
        recorder = self._recorder
        return RecordingResult(
            dropped=recorder.dropped,
            topic_drops=recorder.topic_drops,
            lag=recorder.lag,
            error=recorder.error,
        )

    async def _give_system(self, _request: Nothing, _caller: Caller) -> SystemResult:
        return SystemResult(up_after_s=self._up_after)

    async def _events(self, request: EventsRequest, caller: Caller) -> object:
        if wrong := set(request.kinds) - KINDS:
            listed = ", ".join(sorted(KINDS))
            text = f"kinds: there are no events {min(wrong)!r:.80}; there are: {listed}"
            raise OperationError(Code.BAD_ARGUMENTS, text)
        targets = self._chosen(request.names) if request.names else None
        selection, waiting = Selection(request.kinds, targets), ClientQueue()

        def append(each: Numbered) -> None:
            if selection.wants(each.event):
                waiting.append(partial(message_of, each), *line_of(each.event))

        past = [] if request.only_new else self._feed.recent(request.since)
        with self._feed.followed_by(append):
            for each in past:
                if selection.wants(each.event):
                    await caller.send("event", message_of(each))
            if request.follow:
                await waiting.send(caller.send)
        return {"events": "sent"}

    async def _parameters(self, request: Selected, _caller: Caller) -> list[ParameterNames]:
        configured = dict(_configured(self._system.config))
        found = []
        for target in self._chosen(request.names):
            if target in configured:
                recorded = _names_in(self._recorder.latest(topics.PARAMETERS, full_name(target)))
                names = sorted({*configured[target], *recorded})
                found.append(ParameterNames(full_name(target), names))
        return found

    async def _give_environment(self, _request: Nothing, _caller: Caller) -> dict[str, str]:
        return self._environment

    async def _snapshot(self, _request: Nothing, caller: Caller) -> SnapshotResult:
        async with self._log.recorded("snapshot", (), caller):
            try:
                taken = await self._snapshots.take()
            except SnapshotError as error:
                raise OperationError(Code.REFUSED, str(error)) from None
        return SnapshotResult(messages=taken.messages, bytes=taken.bytes, seconds=taken.seconds)

    def _chosen(self, wanted: Sequence[str]) -> list[Target]:
        view = self._publisher.view
        members = members_of(view, self._system.processes)
        return meant("", wanted, members, nodes_of(view), guests_of(view))


def _restarts_of(target: Target, events: Sequence[RunEvent]) -> Iterator[RestartRecord]:
    for event in events:
        match event:
            case ProcessEvent() if event.name == target and event.kind in _RESTARTS:
                cause = event.message or event.kind.name.lower().replace("_", " ")
                yield RestartRecord(event.stamp_ns, cause)
            case NodeStateChanged() if event.key == target and event.state in _CRASHES:
                yield RestartRecord(
                    event.stamp_ns, f"{event.state}: {event.reason}".removesuffix(": ")
                )


def _output_of(target: Target, events: Sequence[RunEvent]) -> Iterator[LastLine]:
    selection = Selection({"output"}, [target])
    for event in events:
        if isinstance(event, OutputLine) and selection.wants(event):
            yield LastLine(event.stamp_ns, event.stream.value, event.text)


def _configured(config: ReplayConfig) -> Iterator[tuple[Target, list[str]]]:
    for container in config.containers:
        for node in container.composable_nodes:
            yield node.key, [each.name for each in node.parameters]
    for process in config.nodes:
        yield process.full_name, [each.name for each in process.parameters]


def _names_in(message: bytes | None) -> list[str]:
    if message is None:
        return []
    try:
        return [str(each["name"]) for each in NODE_PARAMETERS.read(message)["parameters"]]
    except CdrError:
        return []
