"""The units of a session, what their control groups kept them from, and their failures."""

from __future__ import annotations

import re
import signal as signals
from enum import StrEnum
from typing import TYPE_CHECKING, Final, TypeAlias

from msgspec import Struct, field

from play_launch.container.cdr.messages import GROUP_STATS
from play_launch.container.cdr.structure import CdrError
from play_launch.postmortem.parameters import ParametersOfALife  # noqa: TC001 - a field of a Struct
from play_launch.postmortem.samples import Trend  # noqa: TC001 - as above
from play_launch.postmortem.source_lines import Module, module_of
from play_launch.process.exit import UNKNOWN_STATUS
from play_launch.supervisor.events import (
    ComponentEventKind,
    ContainerState,
    NodeState,
    ProcessEventKind,
    SubjectKind,
)
from play_launch.supervisor.frames import Signature, StackFrame, frame_of, signature_of
from play_launch.supervisor.outcome import BLOCKED_AFTER, Cause, Sequel

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.postmortem.bag_reader import Message
    from play_launch.postmortem.last_lines import LastLines
    from play_launch.supervisor.events import (
        ComponentEvent,
        ManagedNodeChanged,
        NodeStateChanged,
        ProcessEvent,
    )

State: TypeAlias = NodeState | ContainerState | ProcessEventKind

NO_UNIT: Final = 0xFFFF
"""Number of what is no unit, and of the units beyond so many: a page has 16 bits for one."""

_GROUP: Final = GROUP_STATS.picker("group", "throttled_seconds", "oom_kills", "pids_max_hits")
MOST_TIMES: Final = 10_000
"""Moments and downtimes that are kept, of one failure."""
_PROCESS: Final = re.compile(r"\bprocess (\d+)\b")
_EXCEPTION: Final = re.compile(r"uncaught exception ((?:[\w<>, ]|::)+)")


class Fault(StrEnum):
    """What can happen to a unit."""

    CRASHED = "crashed"
    """A composable node died alone."""
    DIED = "died"
    """A container or an ordinary process exited unrequested, and not with status 0."""
    LOAD_FAILED = "load_failed"
    KILLED = "killed"
    """The supervisor killed a container."""
    STOP_TIMEOUT = "stop_timeout"
    """It did not end when it was requested to, and was killed."""
    SLOW = "slow"
    """A constructor took longer than `loading_timeout`."""
    NOT_BROUGHT_UP = "not_brought_up"
    """A managed node did not come to the state that `autostart` names."""


Reason: TypeAlias = tuple[Fault, str, Signature | None]
"""What equal failures have in common; the second is the key of the unit."""


class Downtime(Struct, frozen=True):
    """How long a unit was down."""

    name: str
    ns: int | None
    """Nanoseconds; None: until the end."""


class Failure(Struct, kw_only=True):
    """One thing that happened to a unit, once or more often; details are of the first time."""

    fault: Fault
    key: str
    name: str
    """Name of the unit."""
    container: str = ""
    """Of a node."""
    at_ns: int
    log_time: int
    cause: str
    """In the words of the recording."""
    code: Cause = Cause.NONE
    signature: Signature | None = None
    frames: tuple[StackFrame, ...] = ()
    modules: tuple[Module, ...] = ()
    plugin: str = ""
    package: str = ""
    pid: int = 0
    state: str = ""
    """Before, as recorded (``loaded``); empty: not known."""
    since_ns: int = 0
    """Since when it was in that state."""
    times: list[int] = field(default_factory=list)
    sequels: dict[tuple[Sequel, int], str] = field(default_factory=dict)
    """What the supervisor did and after how many nanoseconds, with its reason if it has one."""
    away: list[Downtime] = field(default_factory=list)
    hit: dict[str, None] = field(default_factory=dict)
    """Names of other units that were down because of it."""
    life_ns: int = 0
    """Log time when the life that ended so began; 0: not known."""
    last_lines: tuple[str, ...] = ()
    before: tuple[Trend, ...] = ()
    """What grew or ran out before."""
    parameters: ParametersOfALife | None = None

    @classmethod
    def of_unit(
        cls, fault: Fault, event: NodeStateChanged | ManagedNodeChanged, unit: Unit, at_ns: int
    ) -> Failure:
        return cls(
            fault=fault,
            key=unit.key,
            name=unit.name,
            container=unit.container,
            at_ns=event.stamp_ns,
            log_time=at_ns,
            cause=event.reason,
            pid=unit.pid,
            state=unit.state.value if isinstance(unit.state, StrEnum) else unit.phase,
            since_ns=unit.since_ns,
        )

    @classmethod
    def of_process(
        cls, fault: Fault, event: ProcessEvent, at_ns: int, state: str, since_ns: int
    ) -> Failure:
        what = ending(event.signal, event.exit_code, "")
        return cls(
            fault=fault,
            key=event.name,
            name=event.name,
            at_ns=event.stamp_ns,
            log_time=at_ns,
            cause=event.message or what,
            code=event.cause,
            signature=Signature(what, (event.name,)),
            pid=event.pid,
            state=state,
            since_ns=since_ns,
        )

    @property
    def is_crash(self) -> bool:
        """Whether a unit ended by a fault: what every command counts as a crash.

        A load that failed is one when the constructor took its process along.
        """
        return self.fault in _ENDS and self.signature is not None

    def explain(self, report: ComponentEvent | None) -> None:
        """Add what the container reported about it."""
        if report is None:
            if self.fault is Fault.CRASHED:  # the report is not in the recording
                self.signature = Signature(self.cause.partition(" (")[0], (self.name,))
            return
        self.cause = report.error_message or self.cause
        self.plugin, self.package = report.plugin_name, report.package_name
        self.pid = report.pid or self.pid
        self.frames = tuple(map(frame_of, report.backtrace))
        self.modules = tuple(filter(None, map(module_of, report.modules)))
        has_crashed = report.kind is ComponentEventKind.CRASHED
        if has_crashed or report.signal or report.exit_code or self.frames:
            what = ending(report.signal, report.exit_code, report.error_message)
            self.signature = signature_of(what, self.frames, self.name)

    def follow(self, sequel: Sequel, delay_ns: int, reason: str = "") -> None:
        """Note what the supervisor did."""
        if sequel is not Sequel.NONE:
            self.sequels[sequel, delay_ns] = reason

    def add_downtime(self, downtime: Downtime) -> None:
        if len(self.away) < MOST_TIMES:
            self.away.append(downtime)


_ENDS: Final = frozenset({Fault.CRASHED, Fault.DIED, Fault.LOAD_FAILED})


class Unit(Struct, kw_only=True):
    """A container, composable node or process; times are nanoseconds since the epoch."""

    number: int
    kind: SubjectKind
    key: str
    name: str
    container: str = ""
    """Of a node."""
    state: State | None = None
    """None: nothing but its samples or output is recorded."""
    since_ns: int = 0
    pid: int = 0
    unique_id: int = 0
    command: tuple[str, ...] = ()
    restarts: int = 0
    """Of a node: reloads."""
    crashes: int = 0
    """As the supervisor counts them."""
    reason: str = ""
    """Why it is in this state."""
    phase: str = ""
    """Of its process: ``running``, ``stopping``, ``killed`` (by the supervisor), ``exited``."""
    is_stopping: bool = False
    is_withdrawn: bool = False
    is_dismissed: bool = False
    """An operator stopped or unloaded it, and has not requested it since."""
    is_guest: bool = False
    """Another program loaded it."""
    changes: list[tuple[int, State, bool]] = field(default_factory=list)
    """Log time, state, and whether it is a failure."""
    failure: Failure | None = None
    """Because of which it is down; after it came back, the latest one."""
    down_since_ns: int = 0
    begun_ns: int = 0
    """Log time when it was started first; of a node, requested."""
    life_ns: int = 0
    """The same, of its latest life: what was written before is not of it."""
    constructing_ns: int = 0
    ready_ns: int = 0
    """Log time when a container was ready first, or a node had arrived, well or not."""
    arrival: NodeState | None = None
    """How a node arrived."""
    waited: str = ""
    """What it waited for before it was started first, in the words of the recording."""
    loaded_ns: int = 0
    """When a node was loaded first."""
    active_ns: int = 0
    """Log time when a managed node was active first."""
    left_ns: int = 0
    """When another program, or it itself, unloaded a node that was not loaded since; else 0."""
    blocks: list[Block] = field(default_factory=list)
    """Of the executor of a node."""

    @property
    def is_known(self) -> bool:
        """Whether more than its samples and output is recorded."""
        return self.state is not None or self.kind is SubjectKind.CONTAINER

    def note_node(
        self, event: NodeStateChanged, container: Unit, at_ns: int, lines: LastLines
    ) -> None:
        """Note whether a life of it begins, it left unrequested, or its executor is blocked."""
        if event.state is NodeState.REQUESTED:
            self.life_ns = at_ns
        if event.state is not NodeState.UNLOADED:
            self.left_ns = 0
        elif self.state is NodeState.LOADED and not container.is_stopping:
            self.left_ns = event.stamp_ns
        is_open = bool(self.blocks) and not self.blocks[-1].end_ns
        if event.cause is not Cause.BLOCKED:
            if is_open:
                self.blocks[-1].end_ns = at_ns
                self.blocks[-1].has_returned = event.cause is Cause.RETURNED
        elif not is_open and len(self.blocks) < MOST_TIMES:
            before = round(BLOCKED_AFTER * 1e9)
            last = lines.of_life(self, at_ns)
            self.blocks.append(Block(event.stamp_ns - before, at_ns - before, last))

    def lost_with(self, container: Unit, stamp_ns: int) -> None:
        """Note that it went because its container did; not if that was requested to."""
        failure = container.failure
        if failure is None or container.is_stopping:
            return
        if self.name != failure.name:
            failure.hit[self.name] = None
        if not self.down_since_ns:
            self.down_since_ns, self.failure = stamp_ns, failure


class Block(Struct):
    """One callback that an executor did not leave for long."""

    at_ns: int
    """When it began, in nanoseconds since the epoch."""
    begin_ns: int
    """The same as log time."""
    last_lines: tuple[str, ...]
    end_ns: int = 0
    """Log time; 0: not before the recording ended."""
    has_returned: bool = False
    """Whether the executor goes on; else the node was stopped, or died."""

    def lasted(self, end_ns: int) -> int:
        """Give nanoseconds, until the recording ended at most."""
        return (self.end_ns or end_ns) - self.begin_ns


class FailureEvent(Struct, frozen=True):
    """One failure of one unit at its moment; equal ones have the same `failure`."""

    unit: Unit
    at_ns: int
    """Log time."""
    failure: Failure | None
    """None: the supervisor gave the unit up."""
    reason: str
    frames: tuple[str, ...] = ()

    @property
    def what(self) -> str:
        """What happened, for a mark in a timeline; empty for what gets none."""
        if self.failure is None:
            return "gave up"
        if self.failure.is_crash and self.failure.fault is not Fault.DIED:
            return "crashed"
        return _MARKS.get(self.failure.fault, "")


_MARKS: Final = {
    Fault.CRASHED: "crashed",
    Fault.DIED: "died",
    Fault.LOAD_FAILED: "failed to load",
    Fault.STOP_TIMEOUT: "did not stop",
    Fault.NOT_BROUGHT_UP: "not brought up",
}


class GroupUse(Struct):
    """What the control groups of one unit were kept from; each process has another group."""

    begin_ns: int = 0
    end_ns: int = 0
    throttled_seconds: float = 0.0
    throttled_ns: int = 0
    """Log time of the first sample with any; 0: none."""
    oom_kills: int = 0
    oom_times: list[int] = field(default_factory=list)
    refused: int = 0
    refused_times: list[int] = field(default_factory=list)
    _latest: tuple[int, float, int, int] = (0, 0.0, 0, 0)

    def take(self, message: Message) -> None:
        """Add what grew since the sample before; the numbers of a new group begin at 0."""
        try:
            latest = _GROUP(message.data)
        except CdrError:
            return
        group, throttled, oom, refused = latest
        same = self._latest if self._latest[0] == group else (group, 0.0, 0, 0)
        at, self._latest = message.log_time, latest
        self.begin_ns, self.end_ns = self.begin_ns or at, at
        if throttled > same[1]:
            self.throttled_seconds += throttled - same[1]
            self.throttled_ns = self.throttled_ns or at
        if oom > same[2]:
            self.oom_kills += oom - same[2]
            self.oom_times += [at][: MOST_TIMES - len(self.oom_times)]
        if refused > same[3]:
            self.refused += refused - same[3]
            self.refused_times += [at][: MOST_TIMES - len(self.refused_times)]


def ending(signal: int, exit_code: int, reason: str) -> str:
    """Name how it ended: the type of an uncaught exception tells most."""
    if found := _EXCEPTION.search(reason):
        return found[1].strip()
    if signal:
        try:
            return signals.Signals(signal).name
        except ValueError:
            return f"signal {signal}"
    return "unknown exit status" if exit_code == UNKNOWN_STATUS else f"exit status {exit_code}"


def named(text: str, units: Iterable[Unit]) -> str:
    """Name the nodes of the processes that a text has the pids of."""
    by_pid = {unit.pid: unit.name for unit in units if unit.container}

    def name(found: re.Match[str]) -> str:
        node = by_pid.get(int(found[1]))
        return f"{found[0]} ({node})" if node else found[0]

    return _PROCESS.sub(name, text)
