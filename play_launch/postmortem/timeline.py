"""What happened in a session: one pass over its recording, one record for each unit.

All commands about recordings count what is here. A failure takes what follows from it: the same one
again, what the supervisor does, downtimes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from play_launch.postmortem.connections import Connections
from play_launch.postmortem.diagnostics import TYPE as DIAGNOSTICS_TYPE
from play_launch.postmortem.diagnostics import Diagnostics
from play_launch.postmortem.events import UnreadableEventError
from play_launch.postmortem.last_lines import LastLines
from play_launch.postmortem.mcap_records import Runs
from play_launch.postmortem.parameters import TOPICS as PARAMETER_TOPICS
from play_launch.postmortem.parameters import Parameters
from play_launch.postmortem.past_session import PastSession
from play_launch.postmortem.samples import Samples
from play_launch.postmortem.units import (
    MOST_TIMES,
    NO_UNIT,
    Downtime,
    Failure,
    FailureEvent,
    Fault,
    GroupUse,
    Unit,
    named,
)
from play_launch.postmortem.version1 import Version1
from play_launch.recording import topics
from play_launch.supervisor.events import (
    ActionEvent,
    ActionPhase,
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    ExpectationChanged,
    GraphChanged,
    LogRecord,
    MachineChanged,
    ManagedNodeChanged,
    ManagedState,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
    RecordingInterrupted,
    RunEvent,
    SubjectKind,
    WantChanged,
    Withdrawn,
)
from play_launch.supervisor.outcome import Cause, Sequel
from play_launch.supervisor.view import has_ended_well, is_guest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from play_launch.postmortem.bag_reader import Message, RecordedTopic, Take, TakeOf
    from play_launch.postmortem.units import Reason, State

MOST_CHANGES: Final = 300_000
"""Changes of state that are kept; further ones are counted."""
MOST_EVENTS: Final = 5_000
"""Failures that are kept one by one; further ones are counted."""
_KILLED: Final = frozenset({Cause.FROZEN, Cause.CHANNEL_FAILED, Cause.NODE_LEFT_LOCK})
_WORDED: Final = frozenset({Sequel.RELOAD, Sequel.CONTAINER_RESTART, Sequel.SHUTDOWN})
"""Sequels that stand at the end of the reason of a node as well."""
_ON_ITS_WAY: Final = frozenset({NodeState.PENDING, NodeState.UNLOADING})
_STATES: Final = frozenset(
    each.name for each in (topics.COMPONENT_EVENTS, topics.STATES, topics.ACTIONS, topics.LOG_ALL)
)
_SIZED: Final = (SubjectKind.CONTAINER, SubjectKind.NODE, SubjectKind.PROCESS)


class Timeline:
    """The state of the pass, whole when all messages were taken and `end` was called."""

    def __init__(self, path: Path) -> None:
        self.session = PastSession(path)
        self.units: list[Unit] = []
        self.failures: list[Failure] = []
        self.events: list[FailureEvent] = []
        self.events_left_out = self.changes_left_out = 0
        self.requests: list[tuple[int, ActionEvent]] = []  # of operators, with their log times
        self.interruptions: list[RecordingInterrupted] = []
        self.machines: dict[str, list[MachineChanged]] = {}
        self.expectations: dict[str, list[ExpectationChanged]] = {}
        self.samples = Samples()
        self.groups: dict[str, GroupUse] = {}
        self.parameters = Parameters()
        self.diagnostics = Diagnostics(self.session)
        self.lines = LastLines()
        self.connections = Connections()
        self._version1 = Version1()
        self._by_key: dict[tuple[bool, str], Unit] = {}
        self._known: dict[Reason, Failure] = {}
        self._reports: dict[str | tuple[int, int], ComponentEvent] = {}
        """Of nodes whose state has not followed yet, by name and by what every one has."""
        self._changes = 0

    def read(self, take_of: TakeOf) -> None:
        """Read the recording, with ``take_of`` to give what takes the messages of a topic.

        Raises:
            NotARecordingError: At once, for another kind of file.
        """
        for _ in self.session.reader.records(take_of):
            pass
        self.end()

    def unit(self, kind: SubjectKind, key: str) -> Unit:
        """Give the unit of that key; it is made when it is new."""
        of_a_node = kind is SubjectKind.NODE
        unit = self._by_key.get((of_a_node, key))
        if unit is None:
            container, _, name = key.partition(":") if of_a_node else ("", "", key)
            number = min(len(self.units), NO_UNIT)
            unit = Unit(number=number, kind=kind, key=key, name=name, container=container)
            self.units.append(unit)
            self._by_key[of_a_node, key] = unit
        elif kind is SubjectKind.CONTAINER:
            unit.kind = kind
        return unit

    def of_topic(self, topic: RecordedTopic) -> Unit | None:
        """Give the unit that a topic has the samples of, if it says."""
        kind = SubjectKind.__members__.get(topic.kind.upper())
        return None if kind is None else self.unit(kind, topic.key)

    def of_name(self, name: str) -> Unit:
        """Give the container or process of that name, or the node of that key."""
        kind = SubjectKind.NODE if ":/" in name else SubjectKind.PROCESS
        return self._by_key.get((":/" in name, name)) or self.unit(kind, name)

    def take_of(self, topic: RecordedTopic) -> Take | Runs | None:
        """Give what takes the messages of a topic."""
        if topic.type_name == topics.PROCESS_STATS:
            self.of_topic(topic)
            return Runs(self.samples.take)
        if topic.type_name == topics.GROUP_STATS:
            return self.groups.setdefault(topic.key, GroupUse()).take
        if topic.name == topics.OUTPUT.name:
            return Runs(self.lines.take)
        if topic.name == topics.SYSTEM.name:
            return self.samples.take_system
        if topic.name in PARAMETER_TOPICS:
            return self._taken_by(self.parameters.take)
        if topic.type_name == DIAGNOSTICS_TYPE:
            return self._taken_by(self.diagnostics.take)
        return self._take_event if topic.name == topics.GRAPH.name else self.failures_of(topic)

    def failures_of(self, topic: RecordedTopic) -> Take | None:
        """Do the same without what was written and measured, which is faster."""
        return self._take_event if topic.name in _STATES else None

    def _take_event(self, message: Message) -> RunEvent | None:
        event = self.session.event(message)
        if event is not None:
            self.fold(event, message.log_time)
        return event

    def _taken_by(self, take: Callable[[Message], object]) -> Take:
        def taken(message: Message) -> None:
            try:
                take(message)
            except UnreadableEventError as error:
                self.session.reader.damaged(str(error))

        return taken

    def fold(self, event: RunEvent, at_ns: int) -> None:
        """Take one event, received at that log time."""
        match event:
            case NodeStateChanged():
                self._node(event, at_ns)
            case ProcessEvent():
                self._process(event, at_ns)
            case ContainerStateChanged():
                self._container(event, at_ns)
            case ComponentEvent(kind=ComponentEventKind.CRASHED | ComponentEventKind.LOAD_FAILED):
                self._reports[event.full_node_name] = event
                if event.unique_id or event.attempt:  # else it is about the container itself
                    self._reports[event.unique_id, event.attempt] = event
            case RecordingInterrupted():
                self.interruptions.append(event)
            case MachineChanged():
                self.machines.setdefault(event.machine, []).append(event)
            case ExpectationChanged():
                self.expectations.setdefault(event.topic, []).append(event)
            case ManagedNodeChanged(state=ManagedState.ACTIVE):
                unit = self.of_name(event.unit)
                unit.active_ns = unit.active_ns or at_ns
            case ManagedNodeChanged(state=ManagedState.FAILED):
                unit = self.of_name(event.unit)
                failure = Failure.of_unit(Fault.NOT_BROUGHT_UP, event, unit, at_ns)
                self._add(failure, unit, event.reason)
            case Withdrawn():
                self.unit(event.kind, event.key).is_withdrawn = True
            case WantChanged():
                self.of_name(event.unit).is_dismissed = not event.is_wanted
            case ActionEvent(phase=ActionPhase.REQUESTED) if len(self.requests) < MOST_EVENTS:
                self.requests.append((at_ns, event))
                for name, is_dismissed in self._version1.dismissals(event):
                    self.of_name(name).is_dismissed = is_dismissed
            case GraphChanged():
                self.connections.take(event)
            case LogRecord():
                self._version1.log(event)

    def end(self) -> None:
        """Finish: no message comes any more, and units that are down stay down."""
        self.lines.end()
        self.diagnostics.fell_silent(self.session.reader.end, is_end=True)
        self.connections.end(self.session.reader.end)
        self.interruptions += self._version1.interruptions()
        for unit in self.units:
            if unit.down_since_ns and unit.failure is not None:
                unit.failure.away.append(Downtime(unit.name, None))

    def _container(self, event: ContainerStateChanged, at_ns: int) -> None:
        unit = self.unit(SubjectKind.CONTAINER, event.container)
        if not isinstance(unit.state, ContainerState):
            unit.changes.clear()
        if event.state is ContainerState.STARTING:
            # With a reason, it waits for its turn.
            unit.waited = unit.waited or ("" if unit.begun_ns else event.reason)
            unit.begun_ns = unit.begun_ns or (0 if event.reason else at_ns)
        elif event.state is ContainerState.RUNNING:
            unit.ready_ns = unit.ready_ns or at_ns
        self._change(unit, event.state, at_ns)

    def _change(self, unit: Unit, state: State, at_ns: int, *, is_failure: bool = False) -> None:
        unit.state, unit.is_withdrawn = state, False
        if self._changes >= MOST_CHANGES:
            self.changes_left_out += 1
            return
        self._changes += 1
        unit.changes.append((at_ns, state, is_failure))

    def _node(self, event: NodeStateChanged, at_ns: int) -> None:
        unit = self.unit(SubjectKind.NODE, str(event.key))
        container = self.unit(SubjectKind.CONTAINER, event.container)
        is_new_crash = unit.state is not None and event.crashes > unit.crashes
        is_repeated = unit.state is event.state and not is_new_crash
        unit.pid = event.pid or unit.pid
        unit.is_guest = is_guest(event.unique_id, event.attempt)
        if event.state is NodeState.LOADING and unit.failure is not None:
            self.lines.settle(unit.failure)
        if event.state is NodeState.LOADING and is_repeated and event.reason:
            slow = Failure.of_unit(Fault.SLOW, event, unit, at_ns)
            self._add(slow, unit, "").cause = event.reason  # the latest one has the longest time
        unit.note_node(event, container, at_ns, self.lines)
        self._arrive(event, unit, at_ns)
        match event.state:
            case NodeState.LOADED if not is_repeated:
                self._is_back(unit, event.stamp_ns)
                if known := self._known.get((Fault.SLOW, unit.key, None)):
                    known.away = [Downtime(event.node, event.elapsed_ns)]
            case NodeState.CRASHED | NodeState.LOAD_FAILED if not is_repeated:
                self._node_failed(event, unit, container, at_ns)
            case NodeState.GAVE_UP if not is_repeated:
                self._gave_up(unit, event.reason, at_ns)
            case NodeState.LOST if not is_repeated:
                unit.lost_with(container, event.stamp_ns)
        unit.crashes, unit.restarts, unit.reason = event.crashes, event.reloads, event.reason
        if not is_repeated:
            self._change(unit, event.state, at_ns)
            unit.since_ns = event.stamp_ns

    def _arrive(self, event: NodeStateChanged, unit: Unit, at_ns: int) -> None:
        if event.state is NodeState.LOADED:
            unit.loaded_ns = unit.loaded_ns or event.stamp_ns
        if unit.arrival is not None:
            return
        if event.state is NodeState.PENDING:
            unit.waited = event.reason or unit.waited
        elif event.state is NodeState.REQUESTED:
            unit.begun_ns = at_ns
        elif event.state is NodeState.LOADING:
            unit.constructing_ns = unit.constructing_ns or at_ns
        elif event.state not in _ON_ITS_WAY:
            unit.ready_ns, unit.arrival = at_ns, event.state

    def _process(self, event: ProcessEvent, at_ns: int) -> None:
        unit = self.of_name(event.name)
        self._version1.is_over |= event.cause is not Cause.NOT_RECORDED
        if event.cause is Cause.NOT_RECORDED:
            event = self._version1.process(event, is_stopping=unit.is_stopping)
        unit.restarts, is_failure = event.restarts, False
        self.connections.run(event)
        match event.kind:
            case ProcessEventKind.STARTED:
                self._is_back(unit, event.stamp_ns)
                if unit.failure is not None:
                    self.lines.settle(unit.failure)
                unit.is_stopping = False
                unit.begun_ns, unit.life_ns = unit.begun_ns or at_ns, at_ns
                if unit.kind is SubjectKind.PROCESS:
                    unit.ready_ns = unit.begun_ns
                unit.phase, unit.pid, unit.command = "running", event.pid, event.command
                unit.since_ns = event.stamp_ns
            case ProcessEventKind.STOPPING if event.cause in _KILLED:
                self._killed(event, unit, at_ns)
            case ProcessEventKind.STOPPING:
                unit.is_stopping, unit.phase, unit.since_ns = True, "stopping", event.stamp_ns
            case ProcessEventKind.EXITED:
                is_failure = self._exited(event, unit, at_ns)
            case ProcessEventKind.WAITING:
                unit.waited = unit.waited or event.message
            case ProcessEventKind.RESTARTING if unit.failure is not None:
                unit.failure.follow(event.sequel, event.delay_ns)
            case ProcessEventKind.GAVE_UP:
                self._gave_up(unit, event.message, at_ns)
        unit.reason = event.message
        if unit.kind is SubjectKind.PROCESS:
            self._change(unit, event.kind, at_ns, is_failure=is_failure)

    def _node_failed(
        self, event: NodeStateChanged, unit: Unit, container: Unit, at_ns: int
    ) -> None:
        by_number = self._reports.pop((event.unique_id, event.attempt), None)
        report = self._reports.pop(event.node, by_number)  # one may have no declared name
        if report is not None:
            self._reports.pop(report.full_node_name, None)
        recorded = event.reason
        if event.cause is Cause.NOT_RECORDED:
            event = self._version1.node(event, report, is_stopping=container.is_stopping)
        elif event.sequel in _WORDED:
            event = replace(event, reason=event.reason.rpartition("; ")[0] or event.reason)
        fault = Fault.CRASHED if event.state is NodeState.CRASHED else Fault.LOAD_FAILED
        if fault is Fault.CRASHED and event.cause is Cause.STOP_TIMEOUT:
            fault = Fault.STOP_TIMEOUT
        failure = Failure.of_unit(fault, event, unit, at_ns)
        failure.code, failure.pid = event.cause, event.pid
        failure.explain(report)
        failure = self._add(failure, unit, recorded)
        if event.sequel is not Sequel.GAVE_UP:  # that has an event of its own, with its reason
            failure.follow(event.sequel, event.delay_ns)
        unit.failure = failure
        if not container.is_stopping:
            unit.down_since_ns = unit.down_since_ns or event.stamp_ns

    def _gave_up(self, unit: Unit, reason: str, at_ns: int) -> None:
        if unit.failure is not None:
            why = reason.removeprefix(unit.reason).lstrip(";: ")
            why = reason.rpartition("; ")[2] if why in {"", reason} else why
            unit.failure.follow(Sequel.GAVE_UP, 0, why)
        self._event(FailureEvent(unit, at_ns, None, reason))

    def _killed(self, event: ProcessEvent, unit: Unit, at_ns: int) -> None:
        """The supervisor kills it; for what a node left behind, that node is to blame."""
        why = named(event.message.partition(": ")[2], self.units)
        culprit = self._by_key.get((True, event.culprit))
        if culprit is not None and culprit.failure is not None:
            failure = culprit.failure
            failure.follow(Sequel.CONTAINER_RESTART, 0, f"{event.name} was killed: {why}")
            failure.hit[event.name] = None
        else:
            failure = Failure.of_process(Fault.KILLED, event, at_ns, unit.phase, unit.since_ns)
            failure.signature, failure.cause = None, why
            failure = self._add(failure, unit, event.message)
        unit.failure, unit.phase, unit.down_since_ns = failure, "killed", event.stamp_ns
        unit.is_stopping = False

    def _exited(self, event: ProcessEvent, unit: Unit, at_ns: int) -> bool:
        """Take the end of a process; return whether it is one that was not wanted."""
        if unit.pid and event.pid not in {0, unit.pid}:
            return False  # it was moved, and runs on another machine by then
        was, since_ns = unit.phase, unit.since_ns
        unit.phase, unit.since_ns = "exited", event.stamp_ns
        may_end = unit.is_stopping or unit.kind is SubjectKind.PROCESS  # a container never is done
        if was == "killed" or (may_end and has_ended_well(event)):
            return was == "killed"
        fault = Fault.DIED
        if unit.is_stopping:
            if event.cause is Cause.STOP_TIMEOUT:
                fault = Fault.STOP_TIMEOUT
            elif event.cause is not Cause.SIGNAL:
                return False
        failure = Failure.of_process(fault, event, at_ns, was, since_ns)
        report = self._reports.pop(event.name, None)
        if report is not None and report.pid == event.pid and event.signal:
            failure.explain(report)
        unit.failure = self._add(failure, unit, event.message)
        if not unit.is_stopping:
            unit.down_since_ns = event.stamp_ns
        return fault is Fault.DIED

    def _is_back(self, unit: Unit, stamp_ns: int) -> None:
        if unit.down_since_ns and unit.failure is not None:
            unit.failure.add_downtime(Downtime(unit.name, stamp_ns - unit.down_since_ns))
        unit.down_since_ns = 0

    def _add(self, failure: Failure, unit: Unit, reason: str) -> Failure:
        """Take a failure, or count it as one that is known."""
        same: Reason = (failure.fault, failure.key, failure.signature)
        known = self._known.get(same)
        if known is None:
            known = self._known[same] = failure
            self.failures.append(failure)
            key, at_ns, failure.life_ns = failure.key, failure.log_time, unit.life_ns
            failure.before = self.samples.before(key, failure.name, failure.pid, at_ns)
            if parameters := self.parameters.nodes.get(failure.name):
                failure.parameters = parameters.of_life(failure.since_ns) or None
            self.lines.request(failure)
        elif failure.fault is Fault.SLOW:
            return known
        if len(known.times) < MOST_TIMES:
            known.times.append(failure.at_ns)
        frames = tuple(frame.text for frame in failure.frames)
        self._event(FailureEvent(unit, failure.log_time, known, reason, frames))
        return known

    def _event(self, event: FailureEvent) -> None:
        if len(self.events) < MOST_EVENTS:
            self.events.append(event)
        else:
            self.events_left_out += 1

    def size(self) -> dict[str, int]:
        """Count the containers, nodes and processes that were not taken out of the system."""
        known = [each.kind for each in self.units if each.is_known and not each.is_withdrawn]
        return {kind.name.lower(): known.count(kind) for kind in _SIZED}


def read_timeline(path: Path, *, only_failures: bool = False) -> Timeline:
    """Read a recording to its end, or to where it cannot be read any more.

    With ``only_failures``, what was written and measured is left out, which is faster.

    Raises:
        NotARecordingError: For another kind of file.
    """
    timeline = Timeline(path)
    timeline.read(timeline.failures_of if only_failures else timeline.take_of)
    return timeline
