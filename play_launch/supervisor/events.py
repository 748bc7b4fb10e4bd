"""Everything that can happen in a run, as immutable values.

Live view, summary, exit code and recording follow from this one stream. Enumerations have the
numbers of the ``play_launch_msgs`` messages.

Units: ``stamp_ns`` is wall-clock time in nanoseconds since the epoch; ``elapsed_ns`` and
``cpu_time_ns`` are durations in nanoseconds; ``start_time`` is in clock ticks after boot
(``/proc/<pid>/stat``, field 22). `Outcome` explains ``cause`` to ``culprit``.
"""

from __future__ import annotations

from enum import IntEnum, StrEnum
from typing import TYPE_CHECKING

from msgspec import Struct

from play_launch.supervisor.endpoints import Endpoint  # noqa: TC001 - a field of a Struct
from play_launch.supervisor.outcome import Cause, Sequel

if TYPE_CHECKING:
    from play_launch.config.node_key import NodeKey


class ComponentEventKind(IntEnum):
    """``play_launch_msgs/ComponentEvent.event_type``."""

    LOADED = 0
    UNLOADED = 1
    LOAD_FAILED = 2
    CRASHED = 3
    LOADING = 4


class ProcessEventKind(IntEnum):
    """``play_launch_msgs/ProcessEvent.event_type``."""

    STARTED = 0
    READY = 1
    EXITED = 2
    RESTARTING = 3
    GAVE_UP = 4
    STOPPING = 5
    WAITING = 6
    """It is not started before what it depends on."""
    STOPPED = 7
    """It was stopped while it did not run, and so is not started."""


class NodeState(StrEnum):
    """What is known about one declared composable node."""

    PENDING = "pending"
    """Not asked for yet (its container is not ready)."""
    REQUESTED = "requested"
    """The load was sent; the container has not answered."""
    LOADING = "loading"
    """Accepted: its constructor runs."""
    LOADED = "loaded"
    LOAD_FAILED = "load failed"
    UNLOADING = "unloading"
    UNLOADED = "unloaded"
    CRASHED = "crashed"
    """The node alone died; its container lives."""
    GAVE_UP = "gave up"
    LOST = "lost"
    """Its container died or forgot it."""


class ContainerState(StrEnum):
    """What is known about one container, or another member of the system."""

    STOPPED = "stopped"
    STARTING = "starting"
    """Waits for its turn to start, or was spawned and has not said hello."""
    RUNNING = "running"
    KILLING = "killing"
    """It was sent SIGKILL, for it no longer answers; its end has not been seen."""
    BACKOFF = "backoff"
    GAVE_UP = "gave up"
    STOPPING = "stopping"


class ManagedState(StrEnum):
    """State of a managed node, as far as it was reported."""

    ABSENT = "absent"
    ASKED = "asked"
    """It exists, and has not reported its state."""
    UNCONFIGURED = "unconfigured"
    CONFIGURING = "configuring"
    INACTIVE = "inactive"
    ACTIVATING = "activating"
    ACTIVE = "active"
    FINALIZED = "finalized"
    FAILED = "failed"
    """A transition failed; the node stays in its state."""


class SubjectKind(IntEnum):
    """What a state or a sample is about: ``play_launch_msgs/StateEvent.kind``."""

    NODE = 0
    CONTAINER = 1
    PROCESS = 2
    MANAGED = 3
    RECORDING = 4
    MACHINE = 5
    EXPECTATION = 6
    WANT = 7


class MemoryKind(IntEnum):
    """What a number of bytes counts: ``play_launch_msgs/ProcessStats.memory_kind``."""

    UNKNOWN = 0
    PSS = 1
    """Proportional set size: of shared pages the share of this process."""
    RSS = 2
    """Resident set size: shared pages in full."""
    SHARED = 3
    """Memory of the container, which the node shares."""


class ActionPhase(IntEnum):
    """``play_launch_msgs/ActionEvent.phase``."""

    REQUESTED = 0
    DONE = 1
    FAILED = 2


class Stream(StrEnum):
    """Where a line of output came from."""

    STDOUT = "stdout"
    STDERR = "stderr"


class _Event(Struct, frozen=True, kw_only=True):
    stamp_ns: int


class ComponentEvent(_Event, frozen=True, kw_only=True):
    """One step of one load attempt, as the container reported it."""

    kind: ComponentEventKind
    container: str
    unique_id: int
    attempt: int
    full_node_name: str
    package_name: str
    plugin_name: str
    error_message: str = ""
    pid: int = 0
    start_time: int = 0
    exit_code: int = 0
    signal: int = 0
    backtrace: tuple[str, ...] = ()
    modules: tuple[str, ...] = ()
    """Libraries and programs of the backtrace: ``name build-id path``, ``-`` for no build id."""
    confirmed_by: str = ""
    """Source of the event where its container did not send it: ``status`` (answer on the control
    channel), ``list_nodes`` (of that service), ``probe`` (scratch process), ``supervisor``."""


class _WithOutcome(_Event, frozen=True, kw_only=True):
    cause: Cause = Cause.NOT_RECORDED
    sequel: Sequel = Sequel.NONE
    delay_ns: int = 0
    culprit: str = ""


class ProcessEvent(_WithOutcome, frozen=True, kw_only=True):
    """One step in the life of a process that the supervisor owns."""

    kind: ProcessEventKind
    name: str
    """Full name of the container or node."""
    pid: int = 0
    start_time: int = 0
    exit_code: int = 0
    signal: int = 0
    restarts: int = 0
    message: str = ""
    """Why, and what happens next."""
    command: tuple[str, ...] = ()


class OutputLine(_Event, frozen=True, kw_only=True):
    """One line that a process wrote, without its line end."""

    process: str
    pid: int
    stream: Stream
    text: str
    truncated: bool = False


class LogRecord(_Event, frozen=True, kw_only=True):
    """One record of the supervisor's own log; ``level`` as in ``rcl_interfaces/Log``."""

    level: int
    """10 debug, 20 info, 30 warning, 40 error, 50 fatal."""
    name: str
    message: str
    file: str = ""
    function: str = ""
    line: int = 0


class NodeStateChanged(_WithOutcome, frozen=True, kw_only=True):
    """The state of a declared composable node changed, or is repeated: its constructor is slow."""

    key: NodeKey
    state: NodeState
    elapsed_ns: int = 0
    """Time since the load was sent, or that it took; 0 where no load is meant."""
    reason: str = ""
    pid: int = 0
    start_time: int = 0
    """Of the process with this pid; 0 where unknown."""
    cpu_time_ns: int = 0
    """CPU time of the constructor; 0 where unknown."""
    unique_id: int = 0
    attempt: int = 0
    crashes: int = 0
    """How often it crashed so far."""
    reloads: int = 0

    @property
    def container(self) -> str:
        return self.key.container

    @property
    def node(self) -> str:
        """Declared full name, or the label of a node that has none."""
        return self.key.name


class ContainerStateChanged(_WithOutcome, frozen=True, kw_only=True):
    """The supervisor's view of a container changed."""

    container: str
    state: ContainerState
    reason: str = ""
    mechanism: str = ""
    """How its nodes are isolated, while it runs: ``shared_memory``, ``process``; else empty."""


class RecordingInterrupted(_Event, frozen=True, kw_only=True):
    """The recording took no data for some time from `stamp_ns` on."""

    reason: str
    lasted_ns: int
    lost: str = ""
    """What is missing in it; empty: nothing."""


class Withdrawn(_Event, frozen=True, kw_only=True):
    """A container, node or process was taken out of the running system, and counts no more."""

    kind: SubjectKind
    key: str
    """As in the changes of state: ``/container:/node`` for a composable node, else the name."""


class WantChanged(_Event, frozen=True, kw_only=True):
    """An operator dismissed a unit, so that it is not to run, or it is wanted again."""

    unit: str
    """A name, or the key of a composable node."""
    is_wanted: bool


class GraphChanged(_Event, frozen=True, kw_only=True):
    """Nodes, of this system or others, came to the domain's graph or left it, up to 0.5 s ago."""

    appeared: tuple[str, ...]
    """Full names, one for each node that bears it."""
    vanished: tuple[str, ...]
    nodes: int
    """How many there are now."""
    endpoints_appeared: tuple[Endpoint, ...] = ()
    endpoints_vanished: tuple[Endpoint, ...] = ()


class ManagedNodeChanged(_Event, frozen=True, kw_only=True):
    """A managed (lifecycle) node that is brought somewhere by ``autostart`` is in another state."""

    unit: str
    """The key of the composable node, written out, or the full name of the process."""
    node: str
    state: ManagedState
    reason: str = ""


class MachineState(StrEnum):
    """State of the part of a system that runs on one of several machines."""

    CONNECTING = "connecting"
    STARTING = "starting"
    RUNNING = "running"
    UNREACHABLE = "unreachable"
    ENDED = "ended"
    FAILED = "failed"


class MachineChanged(_Event, frozen=True, kw_only=True):
    """The part of one of several machines is in another state."""

    machine: str
    state: MachineState
    reason: str = ""


class ExpectationChanged(_Event, frozen=True, kw_only=True):
    """What is expected of a topic is met for the first time, or not any more, or again."""

    topic: str
    is_met: bool
    reason: str = ""
    """What differs; empty when it is met."""


class ActionEvent(_Event, frozen=True, kw_only=True):
    """An operator's request to the running system, or its result."""

    number: int
    """Of the action, from 1 on; all that is published about one has the same."""
    action: str
    """``stop``, ``reload`` ...: an operation of the control socket."""
    phase: ActionPhase
    targets: tuple[str, ...]
    """Full names of containers and processes, keys of composable nodes."""
    uid: int
    """Of the requesting process, as reported by the kernel."""
    pid: int
    command: str
    """Of that process, as it reports itself."""
    reason: str = ""
    """Why it failed; of a request, what was asked for besides."""


class ProcessSample(_Event, frozen=True, kw_only=True):
    """What the process of a container, of an isolated node or of its own used up to now."""

    kind: SubjectKind
    key: str
    """As in the changes of state: ``/container:/node`` for a composable node, else the name."""
    pid: int
    start_time: int
    cpu_percent: float
    """Of one core, since the sample before; in the first one since its start."""
    cpu_seconds: float
    """Since its start, user and system."""
    memory_bytes: int
    memory_kind: MemoryKind
    threads: int
    descriptors: int
    read_bytes: int
    """From storage, since its start."""
    write_bytes: int
    voluntary_switches: int
    """Context switches of its main thread since its start, because it waited."""
    involuntary_switches: int


class GroupSample(_Event, frozen=True, kw_only=True):
    """What a control group used since it was made; NaN and 0 where a controller is not in use."""

    kind: SubjectKind
    key: str
    """As in `ProcessSample`; the group of a container has its isolated nodes in it as well."""
    group: int
    """Which one, by the inode of its folder; of each process and each load of a node another."""
    cpu_seconds: float
    """Of all that was in it."""
    throttled_periods: int
    throttled_seconds: float
    cpu_pressure: float
    """Pressure stall: percent of the latest 10 s in which some of its threads waited for a core."""
    memory_pressure: float
    io_pressure: float
    memory_bytes: int
    processes: int
    oom_kills: int
    """Processes that the kernel killed because memory was exhausted (OOM)."""
    pids_max_hits: int
    """Processes and threads that could not be started because of ``pids_max``."""


class SystemSample(_Event, frozen=True, kw_only=True):
    """What the machine was doing; NaN or 0 where the kernel offers no such number.

    Percentages are of the time since the sample before, sizes are in bytes.
    """

    cpu_percent: float
    """0 to 100, of all cores together."""
    core_percent: tuple[float, ...]
    """Of each core by its number; NaN for one that is offline."""
    core_mhz: tuple[float, ...]
    memory_total: int
    memory_available: int
    swap_used: int
    shm_used: int
    shm_total: int
    disk_free: int
    """On the file system of the recording."""
    load_1: float
    load_5: float
    load_15: float
    cpu_some_avg10: float
    """Pressure stall: percent of the latest 10 s in which some tasks waited for a core."""
    memory_some_avg10: float
    memory_full_avg10: float
    io_some_avg10: float
    io_full_avg10: float
    steal_percent: float
    """Time that the hypervisor gave to other machines."""


Sample = ProcessSample | GroupSample | SystemSample
"""Measurements come all the time: they are recorded, and not shown one by one."""

StateEvent = NodeStateChanged | ContainerStateChanged | ProcessEvent
"""What the view of a system follows from."""

RunEvent = (
    StateEvent
    | Sample
    | ComponentEvent
    | OutputLine
    | LogRecord
    | Withdrawn
    | WantChanged
    | GraphChanged
    | ActionEvent
    | ManagedNodeChanged
    | MachineChanged
    | ExpectationChanged
    | RecordingInterrupted
)
