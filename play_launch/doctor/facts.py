"""What is known about a machine before it is judged.

Sizes are bytes; None means that it could not be found out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto
from typing import TYPE_CHECKING

from play_launch.doctor.surroundings import Surroundings

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.process.cgroups.controllers import Lack


@dataclass(frozen=True, slots=True, kw_only=True)
class PythonFacts:
    """The interpreter and what is installed for it."""

    version: tuple[int, int, int]
    executable: str
    packages: Mapping[str, str] = field(default_factory=dict)
    """Versions by name of those that are installed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RosFacts:
    """Where ROS comes from, and whether Python can use it."""

    source: str = ""
    """``wheels`` or ``system``; empty where there is none, or two."""
    prefix: str = ""
    problem: str = ""
    """Why it cannot be used."""
    import_errors: Mapping[str, str] = field(default_factory=dict)
    """By module, for those that do not load."""
    import_fix: str = ""
    """What helps, where that is known."""
    rmw_in_use: str = ""
    rmw_asked_for: str = ""
    """``RMW_IMPLEMENTATION``."""
    middleware_problem: str = ""
    """Why that one cannot be had."""
    stock_container: str = ""
    """The program of rclcpp_components."""
    ros2_needs: str = ""
    """The line after which ``ros2`` finds our container and messages; empty: it does already."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ContainerFacts:
    """Our own container, started once in an isolated mode and asked."""

    program: str = ""
    problem: str = ""
    """Why there is none, or why it did not answer."""
    fix: str = ""
    """What helps, where that is known."""
    version: str = ""
    backends: tuple[str, ...] = ()
    mechanism: str = ""
    notes: tuple[str, ...] = ()
    allocator: str = ""
    """Library that isolated containers run with."""
    allocator_problem: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class KernelFacts:
    """The kernel and what it offers to supervisors."""

    release: str
    has_pidfd: bool
    proc_problem: str = ""
    """Why ``/proc`` does not show us."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupFacts:
    """Control groups, version 2."""

    folder: str = ""
    """The group below which those of a session are made; empty where none is mounted."""
    controllers: tuple[str, ...] = ()
    """Those that groups below it can have."""
    lacks: Mapping[str, Lack] = field(default_factory=dict)
    """Why the kernel cannot give others."""
    problem: str = ""
    """Why none can be made there, ``; fix: `` and the fix; empty: they can."""


class KeySupport(Enum):
    """What there is of protection keys for memory (x86: PKU)."""

    NO_CPU = auto()
    NO_KERNEL = auto()
    """The CPU has them, and the kernel does not let programs use them."""
    REFUSED = auto()
    """Both have them, and the kernel gives us none."""
    USABLE = auto()


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """One of the limits of getrlimit(2); None is unlimited."""

    soft: int | None
    hard: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitFacts:
    """Limits that matter to many processes and to real-time nodes."""

    nofile: Limit
    nproc: Limit
    core: Limit
    memlock: Limit
    address_space: Limit
    rtprio: Limit
    """Highest real-time priority."""
    nice: Limit
    """20 less the lowest nice value."""
    real_time_share: float | None = None
    """Of a second, the part that real-time threads may take; None: all of it, or not known."""
    may_schedule: bool
    """CAP_SYS_NICE: neither of the two counts."""
    may_lock_memory: bool
    """CAP_IPC_LOCK: the limit does not count."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SharedMemoryFacts:
    """``/dev/shm``, over which DDS moves messages between processes."""

    total: int | None
    free: int | None
    is_writable: bool
    segments: int = 0
    """Files of Fast DDS, of the living and of the dead."""
    leftovers: int = 0
    """Those whose owner is dead."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkFacts:
    """Loopback, and what the environment says about discovery."""

    loopback_works: bool
    loopback_has_multicast: bool | None
    discovery_range: str = ""
    """``ROS_AUTOMATIC_DISCOVERY_RANGE``."""
    localhost_only: str = ""
    """``ROS_LOCALHOST_ONLY``, which the other one has replaced."""
    cyclone_uri: str = ""
    """``CYCLONEDDS_URI``, the configuration of Cyclone DDS."""
    domain_id: str = ""
    """``ROS_DOMAIN_ID``."""
    ephemeral_ports: tuple[int, int] | None = None
    """The first and the last port that the kernel gives to whoever asks for any."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingFacts:
    """Where recordings go."""

    folder: str
    problem: str = ""
    """Why nothing can be written there."""
    free: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineFacts:
    """All of it."""

    python: PythonFacts
    ros: RosFacts
    container: ContainerFacts
    kernel: KernelFacts
    groups: GroupFacts = GroupFacts()
    keys: KeySupport = KeySupport.NO_CPU
    surroundings: Surroundings = Surroundings.LOGIN
    limits: LimitFacts
    shared_memory: SharedMemoryFacts
    network: NetworkFacts
    recording: RecordingFacts
