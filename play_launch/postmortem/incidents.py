"""What happens to the members of a session, event by event: failures, members hit, restarts.

A finding begins as an incident, which takes what follows from it: the same failure once more, what
the supervisor does, and downtimes.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from play_launch.postmortem.findings import Away, Kind
from play_launch.postmortem.frames import Frame, Signature, ending, frame_of, signature_of
from play_launch.postmortem.source_lines import Module, module_of
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
    ContainerStateChanged,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.postmortem.parameters import ParametersOfALife

_SIGKILL: Final = 9
_KILLED: Final = "killed: "
"""How the supervisor says that it kills a process, and why."""
_DEAF: Final = re.compile(r"SIG[A-Z]+ \(it did not leave in time after the signal\)")
"""How a container's words begin where a node was ended by its own deadline."""
_SEQUELS: Final = ("it is loaded again", "it stays away", "everything is stopped")
"""How the supervisor words what follows from a crash."""
_PROCESS: Final = re.compile(r"\bprocess (\d+)\b")
_MOST_TIMES: Final = 10_000
"""Moments of one finding that are kept."""


@dataclass(slots=True)
class Incident:
    """One thing that went wrong, as far as it is known."""

    kind: Kind
    key: str
    """Of the node, as in the recording; else its name."""
    who: str
    container: str
    """Of a node; else empty."""
    stamp_ns: int
    log_time: int
    cause: str
    signature: Signature | None = None
    frames: tuple[Frame, ...] = ()
    modules: tuple[Module, ...] = ()
    plugin: str = ""
    package: str = ""
    pid: int = 0
    state: str = ""
    since_ns: int = 0
    back_at: int = 0
    """When it was started again for the first time; 0: not yet."""
    times: list[int] = field(default_factory=list)
    done: dict[str, None] = field(default_factory=dict)
    away: list[Away] = field(default_factory=list)
    hit: dict[str, None] = field(default_factory=dict)
    last_lines: tuple[str, ...] = ()
    parameters: ParametersOfALife | None = None


class _Subject:
    """A node, container or process, between two events."""

    __slots__ = ("away_since", "incident", "is_stopping", "pid", "since_ns", "state")

    def __init__(self) -> None:
        self.state = ""
        self.since_ns = 0
        self.pid = 0
        self.is_stopping = False
        self.away_since = 0
        self.incident: Incident | None = None
        """Because of which it is away; after it came back, the latest one."""


class Incidents:
    """The fold; ``begun`` learns of each incident at once."""

    def __init__(self, begun: Callable[[Incident], None]) -> None:
        """Begin without any."""
        self.all: list[Incident] = []
        self.bring_up: dict[str, int] = {}
        """When each node was loaded first, by key; nanoseconds since the epoch."""
        self.commands: dict[str, tuple[str, ...]] = {}
        """Of processes, by name."""
        self.latest: Incident | None = None
        """What the latest change of a node or step of a process was, if it went wrong."""
        self._begun = begun
        self._known: dict[tuple[Kind, str, Signature | None], Incident] = {}
        self._subjects: dict[str, _Subject] = {}
        self._nodes: dict[str, NodeStateChanged] = {}
        self._by_pid: dict[int, str] = {}
        self._reports: dict[str, ComponentEvent] = {}
        """Of nodes whose state has not followed yet, by full name, and by what every one has."""
        self._reports_by_number: dict[tuple[int, int], ComponentEvent] = {}
        self._containers: set[str] = set()
        self._deaths: dict[int, Incident] = {}
        self._is_over = False

    def component(self, event: ComponentEvent) -> None:
        """Keep what a container said about the end of a node, for the state that follows."""
        if event.kind in {ComponentEventKind.CRASHED, ComponentEventKind.LOAD_FAILED}:
            self._reports[event.full_node_name] = event
            if event.unique_id or event.attempt:  # else it is about the container itself
                self._reports_by_number[event.unique_id, event.attempt] = event

    def container(self, event: ContainerStateChanged) -> None:
        """Take a change of a container: its process says the rest."""
        self._containers.add(event.container)

    def node(self, event: NodeStateChanged, log_time: int) -> None:
        """Take a change of a node's state."""
        self.latest = None
        key = str(event.key)
        subject = self._subject(key)
        before = self._nodes.get(key)
        self._nodes[key] = event
        if event.pid:
            self._by_pid[event.pid] = event.node
        has_crashed_again = before is not None and event.crashes > before.crashes
        repeated = subject.state == event.state and not has_crashed_again
        if event.state is NodeState.LOADING and subject.incident is not None:
            subject.incident.back_at = subject.incident.back_at or log_time
        if event.state is NodeState.LOADING and repeated and event.reason:
            self._add(self._of_node(Kind.SLOW, event, subject, log_time, event.reason))
        match event.state:
            case NodeState.LOADED if not repeated:
                self._is_back(subject, event.node, event.stamp_ns)
                self.bring_up.setdefault(key, event.stamp_ns)
                if slow := self._known.get((Kind.SLOW, key, None)):
                    slow.away = [Away(event.node, event.elapsed_ns)]
            case NodeState.CRASHED | NodeState.LOAD_FAILED if not repeated:
                self._failed(event, subject, log_time)
            case NodeState.GAVE_UP if subject.incident is not None:
                subject.incident.done[event.reason.rsplit("; ", 1)[-1]] = None
            case NodeState.LOST if not repeated:
                self._lost(event, subject)
        if not repeated:
            subject.state, subject.since_ns = event.state.value, event.stamp_ns

    def process(self, event: ProcessEvent, log_time: int) -> None:
        """Take a step in the life of a process."""
        self.latest = None
        subject = self._subject(event.name)
        match event.kind:
            case ProcessEventKind.STARTED:
                self._is_back(subject, event.name, event.stamp_ns)
                subject.is_stopping = False
                subject.state, subject.since_ns = "running", event.stamp_ns
                subject.pid = event.pid
                self.commands[event.name] = event.command
            case ProcessEventKind.STOPPING if event.message.startswith(_KILLED):
                self._killed(event, subject, log_time)
            case ProcessEventKind.STOPPING:
                self._is_over = subject.is_stopping = True
                subject.state, subject.since_ns = "stopping", event.stamp_ns
            case ProcessEventKind.EXITED:
                self._exited(event, subject, log_time)
            case ProcessEventKind.RESTARTING | ProcessEventKind.GAVE_UP:
                if subject.incident is not None and event.message:
                    subject.incident.done[event.message.rsplit("; ", 1)[-1]] = None

    def end(self) -> None:
        """The recording is over: members that are down stay down; those never up are missing."""
        for name, subject in self._subjects.items():
            if subject.away_since and subject.incident is not None:
                node = self._nodes.get(name)
                subject.incident.away.append(Away(node.node if node else name, None))
        for key, event in self._nodes.items():
            if event.state in _MISSING and self._subjects[key].incident is None:
                if (Kind.SLOW, key, None) in self._known:
                    continue
                subject = self._subjects[key]
                self._add(self._of_node(Kind.NOT_LOADED, event, subject, 0, event.reason))

    def _failed(self, event: NodeStateChanged, subject: _Subject, log_time: int) -> None:
        report = self._report_about(event)
        said = report.error_message if report is not None else ""
        cause, sequel = _split(event.reason, said)
        kind = Kind.CRASHED if event.state is NodeState.CRASHED else Kind.LOAD_FAILED
        container = self._subject(event.container)
        if kind is Kind.CRASHED and (
            _DEAF.match(said or event.reason)
            or (container.is_stopping and report is not None and report.signal == _SIGKILL)
        ):
            kind = Kind.DEAF
        incident = self._of_node(kind, event, subject, log_time, said or cause)
        if report is not None:
            _with_report(incident, report)
        elif kind is Kind.CRASHED:  # what its container said is not in the recording
            incident.signature = Signature(cause.partition(" (")[0], (event.node,))
        incident = self._add(incident)
        if sequel:
            incident.done[sequel] = None
        if event.pid:
            self._deaths[event.pid] = incident
        subject.incident = incident
        if not container.is_stopping:
            subject.away_since = subject.away_since or event.stamp_ns

    def _report_about(self, event: NodeStateChanged) -> ComponentEvent | None:
        """Take what its container said; the configuration may give a node no name."""
        by_number = self._reports_by_number.pop((event.unique_id, event.attempt), None)
        report = self._reports.pop(event.node, by_number)
        if report is not None:
            self._reports.pop(report.full_node_name, None)
        return report

    def _lost(self, event: NodeStateChanged, subject: _Subject) -> None:
        incident = self._subject(event.container).incident
        if incident is None or self._subject(event.container).is_stopping:
            return
        if event.node != incident.who:
            incident.hit[event.node] = None
        if not subject.away_since:
            subject.away_since, subject.incident = event.stamp_ns, incident

    def _killed(self, event: ProcessEvent, subject: _Subject, log_time: int) -> None:
        """The supervisor kills it; for what a dead node left behind, that one is to blame."""
        reason = event.message.removeprefix(_KILLED)
        subject.is_stopping = False
        pids = [int(each) for each in _PROCESS.findall(reason)]
        blamed = next((self._deaths[pid] for pid in reversed(pids) if pid in self._deaths), None)
        named = self._named(reason)
        if blamed is not None:
            blamed.done[f"{event.name} was killed: {named}"] = None
            subject.incident = blamed
            blamed.hit[event.name] = None
        else:
            subject.incident = self._add(
                Incident(
                    Kind.KILLED,
                    event.name,
                    event.name,
                    "",
                    event.stamp_ns,
                    log_time,
                    named,
                    pid=event.pid,
                    state=subject.state,
                    since_ns=subject.since_ns,
                )
            )
        subject.away_since = event.stamp_ns
        subject.state = "killed"

    def _exited(self, event: ProcessEvent, subject: _Subject, log_time: int) -> None:
        was, since = subject.state, subject.since_ns
        subject.state, subject.since_ns = "exited", event.stamp_ns
        if was == "killed" or (event.exit_code == 0 and event.signal == 0):
            return
        kind = Kind.DIED
        if subject.is_stopping:
            if event.signal != _SIGKILL:
                return
            kind = Kind.DEAF
        what = ending(event.signal, event.exit_code, "")
        incident = Incident(
            kind,
            event.name,
            event.name,
            "",
            event.stamp_ns,
            log_time,
            event.message or what,
            signature=Signature(what, (event.name,)),
            pid=event.pid,
            state=was,
            since_ns=since,
        )
        report = self._reports.pop(event.name, None)
        if report is not None and report.pid == event.pid and event.signal:
            incident.cause = report.error_message
            _with_report(incident, report)
        incident = self._add(incident)
        subject.incident = incident
        if not subject.is_stopping:
            subject.away_since = event.stamp_ns

    def _is_back(self, subject: _Subject, name: str, stamp_ns: int) -> None:
        if subject.away_since and subject.incident is not None:
            took = stamp_ns - subject.away_since
            if len(subject.incident.away) < _MOST_TIMES:
                subject.incident.away.append(Away(name, took))
        subject.away_since = 0

    def _of_node(
        self, kind: Kind, event: NodeStateChanged, subject: _Subject, log_time: int, cause: str
    ) -> Incident:
        return Incident(
            kind,
            str(event.key),
            event.node,
            event.container,
            event.stamp_ns,
            log_time or event.stamp_ns,
            cause,
            pid=event.pid,
            state=subject.state,
            since_ns=subject.since_ns,
        )

    def _add(self, incident: Incident) -> Incident:
        """Take an incident, or count it as one that is known."""
        self.latest = incident
        same = (incident.kind, incident.key, incident.signature)
        known = self._known.get(same)
        if known is None:
            known = self._known[same] = incident
            self.all.append(incident)
            self._begun(incident)
        elif incident.kind is Kind.SLOW:
            known.cause = incident.cause  # the latest one has the longest time
            return known
        if len(known.times) < _MOST_TIMES:
            known.times.append(incident.stamp_ns)
        return known

    def _subject(self, key: str) -> _Subject:
        subject = self._subjects.get(key)
        if subject is None:
            subject = self._subjects[key] = _Subject()
        return subject

    def _named(self, text: str) -> str:
        """Say whose processes a text is about."""

        def name(found: re.Match[str]) -> str:
            who = self._by_pid.get(int(found[1]))
            return f"{found[0]} ({who})" if who else found[0]

        return _PROCESS.sub(name, text)


_MISSING: Final = frozenset(
    {NodeState.PENDING, NodeState.REQUESTED, NodeState.LOADING, NodeState.LOST}
)


def _split(reason: str, said: str) -> tuple[str, str]:
    """Divide what is said of an end into the cause, which may be a program's text, and the rest.

    ``said`` is the cause in the container's words, where these are known.
    """
    if said and reason.startswith(said):
        return said, reason.removeprefix(said).removeprefix("; ")
    cause, _, sequel = reason.rpartition("; ")
    return (cause, sequel) if sequel.startswith(_SEQUELS) else (reason, "")


def _with_report(incident: Incident, report: ComponentEvent) -> None:
    """Add what the container said about it."""
    incident.plugin, incident.package = report.plugin_name, report.package_name
    incident.pid = report.pid or incident.pid
    incident.frames = tuple(map(frame_of, report.backtrace))
    incident.modules = tuple(filter(None, map(module_of, report.modules)))
    has_crashed = report.kind is ComponentEventKind.CRASHED
    if has_crashed or report.signal or report.exit_code or incident.frames:
        what = ending(report.signal, report.exit_code, report.error_message)
        incident.signature = signature_of(what, incident.frames, incident.who)
