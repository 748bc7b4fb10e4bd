"""What travels on the control channel, as plain values; `codec` makes frames of them."""

from __future__ import annotations

import re
from enum import IntEnum
from typing import TYPE_CHECKING, Final, TypeAlias

from msgspec import Struct

from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
    NodeState,
    NodeStateChanged,
)
from play_launch.supervisor.outcome import Cause

if TYPE_CHECKING:
    from play_launch.config.model import ParameterConfig


PROTOCOL_VERSION: Final = 1


class Hello(Struct, frozen=True, kw_only=True):
    """First message in each direction (ControlHello).

    From the supervisor only `version`, `pid` and `start_time` say anything. `start_time` is in
    clock ticks after boot. `mechanism` is how an isolated container isolates its nodes, and
    `notes` what that choice rests on.
    """

    version: str
    protocol_version: int = PROTOCOL_VERSION
    pid: int = 0
    start_time: int = 0
    full_node_name: str = ""
    mode: str = ""
    thread_num: int = 0
    backends: tuple[str, ...] = ()
    rmw_implementation: str = ""
    domain_id: int = 0
    mechanism: str = ""
    notes: tuple[str, ...] = ()


class Load(Struct, frozen=True, kw_only=True):
    """Load one node (ControlLoad); empty names are the component's own, log_level 0 is unset."""

    attempt: int
    package_name: str
    plugin_name: str
    node_name: str = ""
    node_namespace: str = ""
    log_level: int = 0
    remap_rules: tuple[str, ...] = ()
    parameters: tuple[ParameterConfig, ...] = ()
    extra_arguments: tuple[ParameterConfig, ...] = ()
    resources: tuple[str, ...] = ()
    """What its process asks of the kernel, see `play_launch.config.resources`."""
    lock_memory: bool = False


class Accepted(Struct, frozen=True, kw_only=True):
    """The load was taken up (ControlAccepted)."""

    attempt: int
    unique_id: int


class Rejected(Struct, frozen=True, kw_only=True):
    """A request was not taken up (ControlRejected).

    `attempt` is that of a load, else 0; `unique_id` names the node it was about, or 0.
    """

    attempt: int
    unique_id: int
    reason: str


NO_NODE: Final = (0,)
"""The ids of a query that only asks for a sign of life: containers number their nodes from 1."""


class Query(Struct, frozen=True, kw_only=True):
    """Which nodes do you have? No `unique_ids` means all, `NO_NODE` none (ControlQuery)."""

    query_id: int
    unique_ids: tuple[int, ...] = ()


class NodeStatus(Struct, frozen=True, kw_only=True):
    """One node as its container sees it.

    `elapsed_ns` is the time in this state and `cpu_time_ns` what its constructor used up (0 once
    loaded), in nanoseconds; `start_time` is in clock ticks after boot. `silence_ns` is the time
    since the node's executor last came round between two callbacks, or -1 where that is not known.
    `note` says in words what there is to say besides: what a node waits for whose constructor has
    not begun.
    """

    unique_id: int
    attempt: int
    state: NodeStatusState
    full_node_name: str
    pid: int = 0
    start_time: int = 0
    elapsed_ns: int = 0
    cpu_time_ns: int = 0
    note: str = ""
    silence_ns: int = -1


class Status(Struct, frozen=True, kw_only=True):
    """The answer to the query of the same `query_id` (ControlStatus).

    A node that was asked about and is not listed does not exist; those that have been silent for
    5 s are always listed. The numbers are counted since the container's start: frames that its full
    queue dropped, nodes that crashed, of these cleaned up after and not cleaned up after, and
    deaths in the middle of something that others use, too. `dead_locks` says, a line each, which
    threads wait without end, because the holder of the lock has exited, and which nodes hang in the
    middleware.
    """

    query_id: int
    nodes: tuple[NodeStatus, ...] = ()
    dropped_frames: int = 0
    crashes: int = 0
    undertaken: int = 0
    leaked: int = 0
    unquiesced: int = 0
    dead_locks: tuple[str, ...] = ()


_STOP_TIMEOUT: Final = re.compile(r"SIG[A-Z]+ \(it did not leave in time after the signal\)")
_EXCEPTION: Final = re.compile(r"SIG[A-Z]+ \(uncaught exception ")
_HOLDER: Final = re.compile(r" held by process (\d+)\b")


def cause_of(event: ComponentEvent) -> Cause:
    """Read why a node ended from how our containers begin their message about it."""
    if _STOP_TIMEOUT.match(event.error_message):
        return Cause.STOP_TIMEOUT
    if _EXCEPTION.match(event.error_message):
        return Cause.EXCEPTION
    if event.signal:
        return Cause.SIGNAL
    has_exited = event.exit_code or event.kind is ComponentEventKind.CRASHED
    return Cause.EXIT_STATUS if has_exited else Cause.NONE


def state_of_guest(event: ComponentEvent) -> NodeStateChanged:
    """Give the state of a node that another program loaded, of which nothing is decided."""
    return NodeStateChanged(
        stamp_ns=event.stamp_ns,
        key=NodeKey(event.container, event.full_node_name or f"/[{event.plugin_name}]"),
        state=NodeState[event.kind.name],
        reason=event.error_message or "by another program",
        cause=cause_of(event),
        pid=event.pid,
        start_time=event.start_time,
        unique_id=event.unique_id,
        crashes=int(event.kind is ComponentEventKind.CRASHED),
    )


def lock_holder(dead_lock: str) -> int:
    """Read the pid of a node that exited with a lock from a line of `Status.dead_locks`."""
    found = _HOLDER.search(dead_lock)
    return int(found[1]) if found else 0


class Cancel(Struct, frozen=True, kw_only=True):
    """Give up a load (ControlCancel)."""

    unique_id: int


class Unload(Struct, frozen=True, kw_only=True):
    """Unload a node (ControlUnload)."""

    unique_id: int


class Shutdown(Struct, frozen=True, kw_only=True):
    """Unload everything and exit with status 0 (ControlShutdown)."""

    reason: str = ""


Incoming: TypeAlias = Hello | Accepted | Rejected | ComponentEvent | Status
"""What a container sends."""
Outgoing: TypeAlias = Hello | Load | Query | Cancel | Unload | Shutdown
"""What a supervisor sends."""


class NodeStatusState(IntEnum):
    """``play_launch_msgs/NodeStatus.state``, and one that no container sends."""

    CONSTRUCTING = 0
    LOADED = 1
    UNLOADING = 2
    QUEUED = 255
    """A load that waits on our side, in the queue of a stock container."""
