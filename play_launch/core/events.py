"""Everything that can happen in a run, as immutable values.

These are the only things that actors publish: the live view, the summary, the exit code
and the recording are all derived from this one stream. The numbers of the enumerations are those
of the ``play_launch_msgs`` messages, so that they can go to the wire and the recording unchanged.

Units: ``stamp_ns`` is wall-clock time in nanoseconds since the epoch; ``elapsed_ns`` and
``cpu_time_ns`` are durations in nanoseconds; ``start_time`` is in clock ticks after boot
(``/proc/<pid>/stat``, field 22).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import TYPE_CHECKING, Final, Protocol

from msgspec import Struct

if TYPE_CHECKING:
    from play_launch.core.node_key import NodeKey


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


class NodeState(StrEnum):
    """What is known about one declared composable node."""

    PENDING = "pending"
    """Not asked for yet (its container is not ready)."""
    REQUESTED = "requested"
    """The load was sent; the container has not answered."""
    LOADING = "loading"
    """Accepted: it has a unique_id and its constructor runs."""
    LOADED = "loaded"
    LOAD_FAILED = "load failed"
    UNLOADING = "unloading"
    UNLOADED = "unloaded"
    CRASHED = "crashed"
    """The node alone died; its container lives."""
    GAVE_UP = "gave up"
    """It crashed and is not loaded again by itself."""
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
    """Dead; waits before it is started again."""
    GAVE_UP = "gave up"
    STOPPING = "stopping"


class Stream(StrEnum):
    """Where a line of output came from."""

    STDOUT = "stdout"
    STDERR = "stderr"


# Not a Struct, which would compare all of its fields.
@dataclass(frozen=True, slots=True, kw_only=True)
class ComponentEvent:
    """One step of one load attempt, as the container reported it."""

    stamp_ns: int
    kind: ComponentEventKind
    container: str
    """Full name of the container's node."""
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
    confirmed_by: str = ""
    """How it is known when the container has not said it by itself, else empty.

    ``"status"`` and ``"list_nodes"``: it was asked, by the control channel or the service of that
    name. ``"probe"``: a scratch process loaded the library. ``"supervisor"``: it was decided by us.
    """
    received: bytes = field(default=b"", compare=False, repr=False)
    """The message in CDR as its container sent it, for the recording; else empty."""


class ProcessEvent(Struct, frozen=True, kw_only=True):
    """One step in the life of a process that the supervisor owns."""

    stamp_ns: int
    kind: ProcessEventKind
    name: str
    """Full name of the container or node."""
    pid: int = 0
    start_time: int = 0
    exit_code: int = 0
    signal: int = 0
    restarts: int = 0
    """How often this member was restarted so far."""
    message: str = ""
    """Why, and what happens next."""
    command: tuple[str, ...] = ()


class OutputLine(Struct, frozen=True, kw_only=True):
    """One line that a process wrote, without its line end."""

    stamp_ns: int
    process: str
    """Full name of the container or node."""
    pid: int
    stream: Stream
    text: str
    truncated: bool = False


class LogRecord(Struct, frozen=True, kw_only=True):
    """One record of the supervisor's own log; ``level`` as in ``rcl_interfaces/Log``."""

    stamp_ns: int
    level: int
    """10 debug, 20 info, 30 warning, 40 error, 50 fatal."""
    name: str
    message: str
    file: str = ""
    function: str = ""
    line: int = 0


class NodeStateChanged(Struct, frozen=True, kw_only=True):
    """The supervisor's view of a declared composable node changed, or is reported again.

    It is repeated with the same state while a constructor is slow.
    """

    stamp_ns: int
    key: NodeKey
    state: NodeState
    elapsed_ns: int = 0
    """Time since the load was sent, or that it took; 0 where no load is meant."""
    reason: str = ""
    pid: int = 0
    cpu_time_ns: int = 0
    """CPU time of the constructor; 0 where unknown."""
    unique_id: int = 0
    attempt: int = 0
    crashes: int = 0
    """How often it crashed so far."""
    reloads: int = 0
    """How often it was loaded again because of that."""

    @property
    def container(self) -> str:
        """Full name of the container that it is declared in."""
        return self.key.container

    @property
    def node(self) -> str:
        """Declared full name, or the label of a node that has none."""
        return self.key.name


class ContainerStateChanged(Struct, frozen=True, kw_only=True):
    """The supervisor's view of a container changed."""

    stamp_ns: int
    container: str
    state: ContainerState
    reason: str = ""
    mechanism: str = ""
    """How its nodes are isolated, while it runs: ``shared_memory``, ``process``; else empty."""


class GraphChanged(Struct, frozen=True, kw_only=True):
    """Nodes came into the ROS graph, or left it, as the graph daemon sees it.

    They may be anybody's: the graph is that of the whole ROS domain. A name stands there as often
    as there are nodes that bear it.
    """

    stamp_ns: int
    """When it was noticed, up to half a second after it happened."""
    appeared: tuple[str, ...]
    """Full names."""
    vanished: tuple[str, ...]
    nodes: int
    """How many there are now."""


RunEvent = (
    ComponentEvent
    | ProcessEvent
    | OutputLine
    | LogRecord
    | NodeStateChanged
    | ContainerStateChanged
    | GraphChanged
)


REPORTED_LOGGER: Final = "play_launch.reported"
"""Logger for what an event reports as well: recorded, but shown once only."""


class EventSink(Protocol):
    """Takes events; never blocks. Call it from the loop's thread unless a sink says otherwise."""

    def publish(self, event: RunEvent) -> None:
        """Take one event."""
