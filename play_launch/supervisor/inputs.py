# ruff: noqa: TC001, TC003 - msgspec resolves the annotations to read recorded inputs
"""Inputs of the supervisor, and the effects that it asks for.

What belongs to an earlier start (``start``) or load (``attempt``) changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum, auto
from typing import TypeAlias

from msgspec import Struct, field

from play_launch.config.dependency import Condition
from play_launch.config.model import ReplayConfig
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import ManagedState
from play_launch.supervisor.outcome import Cause
from play_launch.supervisor.plan import Step, StepOutcome
from play_launch.supervisor.transitions import NodeFact
from play_launch.supervisor.world import Exit, Hello, Limits


class ManagedInput(StrEnum):
    """What can happen to a managed node."""

    UP = auto()
    """The node is loaded, or its process runs."""
    GONE = auto()
    IS_UNCONFIGURED = auto()
    IS_INACTIVE = auto()
    IS_ACTIVE = auto()
    IS_FINALIZED = auto()
    REFUSED = auto()
    """A transition failed."""
    OVERDUE = auto()
    """No answer within the limit."""


class _Input(Struct, frozen=True, tag=True, omit_defaults=True):
    pass


class UnitReport(_Input, frozen=True):
    """A report about one start of a process; about an earlier one, it changes nothing."""

    unit: str
    start: int


class Time(_Input, frozen=True):
    """The session begins, or something is due."""


class Started(UnitReport, frozen=True):
    """A process runs."""

    pid: int
    start_time: int
    argv: tuple[str, ...] = ()


class NotStarted(UnitReport, frozen=True):
    """A process could not be started."""

    reason: str
    is_permanent: bool
    """Whether the next start would fail in the same way."""


class Greeted(UnitReport, frozen=True):
    """A container sent its hello message: it is ready."""

    hello: Hello


class Faulty(UnitReport, frozen=True):
    """A process has to be killed: it is frozen, or its control channel failed."""

    reason: str
    is_fatal: bool = False
    """Whether a restart would not help."""
    cause: Cause = Cause.CHANNEL_FAILED


class Exited(UnitReport, frozen=True):
    """A process exited, and all that it sent before was processed."""

    exit: Exit


class CleanedUp(UnitReport, frozen=True):
    """Nothing of an exited process is left."""


class Unkillable(UnitReport, frozen=True):
    """A process lives on after the last signal of its stop."""


class Failed(_Input, frozen=True):
    """An effect or a source of a unit raised an exception."""

    unit: str
    reason: str


class NodeReported(UnitReport, frozen=True, kw_only=True):
    """A container reported something about one node."""

    said: NodeFact
    attempt: int = 0
    unique_id: int = 0
    reason: str = ""
    pid: int = 0
    start_time: int = 0
    cpu_time_ns: int = 0
    signal: int = 0
    full_node_name: str = ""
    cause: Cause = Cause.NONE


class HealthReported(UnitReport, frozen=True):
    """A container reported its health in the answer to a query."""

    leaked: int = 0
    """Crashed nodes whose leftovers could not be cleaned up."""
    unquiesced: int = 0
    """Crashed nodes that were killed, so that locks they held may remain locked."""
    dead_locks: tuple[str, ...] = ()
    """Waits for a lock that an exited node holds; `lock_holder` is the pid of the first one."""
    silences: Mapping[int, float] = field(default_factory=dict)
    """By attempt: seconds for which the executor of a node has been blocked in a callback."""
    lock_holder: int = 0


class ProbeResult(Struct, frozen=True, kw_only=True):
    """Result of loading a library in a scratch process."""

    loads: bool = False
    library: str = ""
    error: str = ""
    """Reason why it cannot be loaded; empty if it can."""
    exit_code: int = 0
    signal: int = 0
    modules: tuple[str, ...] = ()
    """Libraries of the backtrace, as in a `ComponentEvent`."""
    backtrace: tuple[str, ...] = ()
    """Innermost first."""


class Probed(_Input, frozen=True):
    """The library of a node was loaded in a scratch process; None: that could not be tried."""

    node: NodeKey
    finding: ProbeResult | None


class Found(_Input, frozen=True):
    """What starts depend on and is there now: lines that were written, files, the ROS graph."""

    met: frozenset[tuple[Condition, str, str]]
    """Condition, unit (of a line) and subject."""


class GoalReported(_Input, frozen=True):
    """A managed node is in a state, or failed to change it."""

    unit: str
    instance: int
    said: ManagedInput
    reason: str = ""


class StopRequested(_Input, frozen=True):
    """The system is to stop."""

    reason: str = ""
    is_hurried: bool = False
    """Whether each stop skips to its next signal."""


class StartRequested(_Input, frozen=True):
    """An operator wants a process to run, or a node to be loaded, whatever it depends on."""

    unit: str
    """Name of a process, or text of the key of a node."""
    anew: bool = False
    """Whether a running one is replaced."""
    reason: str = ""


class EndRequested(_Input, frozen=True):
    """An operator wants a process to stop, or a node to be unloaded."""

    unit: str
    reason: str = ""


class ChangeRequested(_Input, frozen=True):
    """Another configuration is to be applied; everything that it needs is prepared."""

    target: ReplayConfig
    phases: tuple[tuple[Step, ...], ...]
    limit: float
    """Seconds for each step."""


class ParametersSet(_Input, frozen=True):
    """The parameters of a step were set, or refused."""

    step: Step
    refusal: str


_OfProcess: TypeAlias = Started | NotStarted | Greeted | Faulty | Exited | CleanedUp | Unkillable
_OfNode: TypeAlias = NodeReported | HealthReported | Probed | GoalReported
_Asked: TypeAlias = StopRequested | StartRequested | EndRequested | ChangeRequested | ParametersSet
Input: TypeAlias = Time | Failed | Found | _OfProcess | _OfNode | _Asked


class Origin(_Input, frozen=True):
    """What a world was made of; it stands before the inputs in a recording."""

    config: ReplayConfig
    starts: int
    limits: Limits
    stamp_ns: int


class Over(_Input, frozen=True):
    """No more inputs follow in a recording."""


class Spawn(Struct, frozen=True):
    """Start the process of a unit, as `Process.config` says."""

    unit: str
    start: int


class Kill(Struct, frozen=True):
    """Send SIGKILL to the process of a unit, or give its start up that is not answered yet."""

    unit: str
    start: int


class Stop(Struct, frozen=True):
    """Stop the process of a unit, from gentle to hard, and end its scratch processes."""

    unit: str
    start: int
    asks: bool
    """Whether the container is asked over the control channel first."""
    reason: str


class Load(Struct, frozen=True):
    """Request a load."""

    node: NodeKey
    attempt: int

    @property
    def container(self) -> str:
        return self.node.container


class Unload(Struct, frozen=True):
    """Request that a node is unloaded, or that its load is given up."""

    container: str
    unique_id: int
    is_loading: bool


class Query(Struct, frozen=True):
    """Query a container about nodes: keys with attempt and unique_id."""

    container: str
    about: tuple[tuple[NodeKey, int, int], ...]


class Probe(Struct, frozen=True):
    """Load the libraries of nodes in scratch processes."""

    container: str
    nodes: tuple[NodeKey, ...]


class Drive(Struct, frozen=True):
    """Talk to a managed node."""

    unit: str
    instance: int
    to: ManagedState
    """`ASKED`: begin with its state; `CONFIGURING`, `ACTIVATING`: request the transition;
    `ABSENT`: end the conversation."""


class SetParameters(Struct, frozen=True):
    """Set the parameters that a step names on a running node."""

    step: Step


class End(Struct, frozen=True):
    """Request the stop of the whole system."""

    reason: str


class Log(Struct, frozen=True):
    """Log a warning or an error."""

    text: str
    is_error: bool = False
    is_shown_otherwise: bool = False
    """Whether an event shows the same to users."""


class Raised(Struct, frozen=True):
    """A rule of a unit raised an exception: log it, and let the unit fail."""

    unit: str
    error: Exception


_ToProcess: TypeAlias = Spawn | Kill | Stop | Load | Unload | Query | Probe
Effect: TypeAlias = _ToProcess | Drive | SetParameters | StepOutcome | End | Log | Raised
