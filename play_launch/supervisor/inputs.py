# ruff: noqa: TC001, TC003 - msgspec resolves the annotations to read recorded inputs
"""Inputs of the supervisor, and the effects that it asks for.

What belongs to an earlier start (``start``) or load (``attempt``) changes nothing.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final, TypeAlias

from msgspec import Struct, field

from play_launch.config.dependency import Condition
from play_launch.config.model import ReplayConfig
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.goal_life import ManagedInput
from play_launch.supervisor.node_life import NodeFact
from play_launch.supervisor.outcome import Cause
from play_launch.supervisor.steps import Step
from play_launch.supervisor.world import Exit, Hello, Limits


class Begun(Struct, frozen=True, tag=True):
    """The session begins."""


class Time(Struct, frozen=True, tag=True):
    """Something is due."""


class Started(Struct, frozen=True, tag=True):
    """A process runs."""

    unit: str
    start: int
    pid: int
    start_time: int
    argv: tuple[str, ...] = ()


class NotStarted(Struct, frozen=True, tag=True):
    """A process could not be started."""

    unit: str
    start: int
    reason: str
    is_permanent: bool
    """Whether the next start would fail in the same way."""


class Greeted(Struct, frozen=True, tag=True):
    """A container sent its hello message: it is ready."""

    unit: str
    start: int
    hello: Hello


class Faulty(Struct, frozen=True, tag=True):
    """A process has to be killed: it is frozen, or its control channel failed."""

    unit: str
    start: int
    reason: str
    is_fatal: bool = False
    """Whether a restart would not help."""
    cause: Cause = Cause.CHANNEL_FAILED


class Exited(Struct, frozen=True, tag=True):
    """A process exited, and all that it sent before was processed."""

    unit: str
    start: int
    exit: Exit


class CleanedUp(Struct, frozen=True, tag=True):
    """Nothing of an exited process is left."""

    unit: str
    start: int


class Unkillable(Struct, frozen=True, tag=True):
    """A process lives on after the last signal of its stop."""

    unit: str
    start: int


class Failed(Struct, frozen=True, tag=True):
    """An effect or a source of a unit raised an exception."""

    unit: str
    reason: str


class NodeReported(Struct, frozen=True, tag=True, kw_only=True, omit_defaults=True):
    """A container reported something about one node."""

    unit: str
    start: int
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


class HealthReported(Struct, frozen=True, tag=True, omit_defaults=True):
    """A container reported its health in the answer to a query."""

    unit: str
    start: int
    leaked: int = 0
    """Crashed nodes whose leftovers could not be cleaned up."""
    unquiesced: int = 0
    """Crashed nodes that were killed, so that locks they held may remain locked."""
    dead_locks: tuple[str, ...] = ()
    """Waits for a lock that an exited node holds; `lock_holder` is the pid of the first one."""
    silences: Mapping[int, float] = field(default_factory=dict)
    """By attempt: seconds for which the executor of a node has been blocked in a callback."""
    lock_holder: int = 0


_RUNTIME: Final = re.compile(r"\b(?:libc|libstdc\+\+|libgcc_s|libpthread|ld-linux[\w-]*)\.so\b")


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

    @property
    def blamed(self) -> str:
        return blamed_frame(self.backtrace)

    @property
    def is_about_library(self) -> bool:
        """Whether it holds for every component of the library, not only for the one asked for."""
        return self.loads or self.signal != 0


def blamed_frame(backtrace: Sequence[str]) -> str:
    """Choose the frame to show where there is room for one: the caller of abort(), not abort()."""
    return next((frame for frame in backtrace if not _RUNTIME.search(frame)), backtrace[0])


class Probed(Struct, frozen=True, tag=True):
    """The library of a node was loaded in a scratch process; None: that could not be tried."""

    node: NodeKey
    finding: ProbeResult | None


class LineSeen(Struct, frozen=True, tag=True):
    """A process wrote a line that matches a pattern that others depend on."""

    unit: str
    pattern: str


class FilesSeen(Struct, frozen=True, tag=True):
    """The files that exist, of those that are waited for."""

    paths: frozenset[str]


class GraphSeen(Struct, frozen=True, tag=True):
    """What the ROS graph has, of what is waited for."""

    found: frozenset[tuple[Condition, str]]


class GoalReported(Struct, frozen=True, tag=True):
    """A managed node is in a state, or failed to change it."""

    unit: str
    instance: int
    said: ManagedInput
    reason: str = ""


class StopRequested(Struct, frozen=True, tag=True):
    """The system is to stop; a second signal skips to the next stop signal."""

    reason: str
    signum: int | None = None


class Hurried(Struct, frozen=True, tag=True):
    """A second stop request: each stop skips to its next signal."""


class StartRequested(Struct, frozen=True, tag=True):
    """An operator wants a process to run, whatever it depends on."""

    unit: str
    anew: bool = False
    """Whether a running one is replaced."""
    reason: str = ""


class EndRequested(Struct, frozen=True, tag=True):
    """An operator wants a process to stop."""

    unit: str
    reason: str


class LoadRequested(Struct, frozen=True, tag=True):
    """An operator wants a node to be loaded, whatever it depends on."""

    node: NodeKey
    anew: bool = False


class UnloadRequested(Struct, frozen=True, tag=True):
    """An operator wants a node to be unloaded."""

    node: NodeKey


class ChangeRequested(Struct, frozen=True, tag=True):
    """Another configuration is to be applied; everything that it needs is prepared."""

    target: ReplayConfig
    phases: tuple[tuple[Step, ...], ...]
    limit: float
    """Seconds for each step."""


class ParametersSet(Struct, frozen=True, tag=True):
    """The parameters of a step were set, or refused."""

    step: Step
    refusal: str


Input: TypeAlias = (
    Begun
    | Time
    | Started
    | NotStarted
    | Greeted
    | Faulty
    | Exited
    | CleanedUp
    | Unkillable
    | Failed
    | NodeReported
    | HealthReported
    | Probed
    | LineSeen
    | FilesSeen
    | GraphSeen
    | GoalReported
    | StopRequested
    | Hurried
    | StartRequested
    | EndRequested
    | LoadRequested
    | UnloadRequested
    | ChangeRequested
    | ParametersSet
)


class Origin(Struct, frozen=True, tag=True):
    """What a world was made of; it stands before the inputs in a recording."""

    config: ReplayConfig
    starts: int
    limits: Limits
    stamp_ns: int


class Over(Struct, frozen=True, tag=True):
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
    """Stop the process of a unit, from gentle to hard."""

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


class Cancel(Struct, frozen=True):
    """Request that a load is given up."""

    container: str
    unique_id: int


class Unload(Struct, frozen=True):
    """Request that a node is unloaded."""

    container: str
    unique_id: int


class Query(Struct, frozen=True):
    """Query a container about nodes: keys with attempt and unique_id."""

    container: str
    about: tuple[tuple[NodeKey, int, int], ...]


class Probe(Struct, frozen=True):
    """Load the libraries of nodes in scratch processes."""

    container: str
    nodes: tuple[NodeKey, ...]


class CancelProbes(Struct, frozen=True):
    """End the scratch processes of a container."""

    container: str


class Drive(Struct, frozen=True):
    """Begin to talk to a managed node, first about its state."""

    unit: str
    instance: int


class Transit(Struct, frozen=True):
    """Request a transition of a managed node."""

    unit: str
    instance: int
    action: str
    """``configure`` or ``activate``."""


class Release(Struct, frozen=True):
    """End the conversation with a managed node."""

    unit: str


class SetParameters(Struct, frozen=True):
    """Set the parameters that a step names on a running node."""

    step: Step


class StepEnded(Struct, frozen=True):
    """A step of a change ended: result ``done`` or ``failed``, reason, seconds."""

    step: Step
    is_done: bool
    reason: str
    seconds: float


class ChangeEnded(Struct, frozen=True):
    """All steps of a change ended, or were skipped."""


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


Effect: TypeAlias = (
    Spawn
    | Log
    | Raised
    | End
    | Kill
    | Stop
    | Load
    | Cancel
    | Unload
    | Query
    | Probe
    | CancelProbes
    | Drive
    | Transit
    | Release
    | SetParameters
    | StepEnded
    | ChangeEnded
)
