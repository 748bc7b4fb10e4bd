"""What a process requests of the kernel: scheduling, CPUs, limits, and its control group.

All but the control group is inherited by its threads and processes. `Resources.settings` is what
``container_native/src/base/resource_setting.hpp`` reads. The files of control groups (see the
kernel's documentation, Control Group v2) are written by `play_launch.process.cgroups`.
"""

from __future__ import annotations

import math
import resource
from enum import IntEnum, StrEnum
from pathlib import Path  # noqa: TC003 - as in `play_launch.config.model`
from typing import TYPE_CHECKING, Any, Final, TypeVar

from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Iterable

    _Infinite = TypeVar("_Infinite", int, str)

NO_LIMIT: Final = math.inf
_UNLIMITED: Final = 2**64 - 1
_IO_CLASS_SHIFT: Final = 13
_NICE_TO_LIMIT: Final = 20
_GROUP_FILES: Final = {
    "cpuset": "cpuset.cpus",
    "cpu_weight": "cpu.weight",
    "cpu_max": "cpu.max",
    "io_weight": "io.weight",
    "pids_max": "pids.max",
    "memory_high": "memory.high",
    "memory_max": "memory.max",
}
"""The file of each limit, in the order in which they are written."""


class CpuMax(Struct, frozen=True):
    """CPU time in each period, of all CPUs together, in microseconds; infinity: any."""

    quota: float
    period: int = 100_000

    @property
    def percent(self) -> float:
        """The share of one CPU; 200 is two CPUs."""
        return 100 * self.quota / self.period

    def __str__(self) -> str:
        return f"{_number(self.quota, 'max')} {self.period}"


class GroupLimits(Struct, frozen=True, kw_only=True):
    """Limits of a control group; None and empty: none. Memory is in bytes, infinity is no limit."""

    cpu_max: CpuMax | None = None
    cpu_weight: int | None = None
    cpuset: tuple[int, ...] = ()
    """Numbers of CPUs, in order."""
    io_weight: int | None = None
    pids_max: float | None = None
    memory_high: float | None = None
    memory_max: float | None = None

    def __bool__(self) -> bool:
        return self != NO_LIMITS

    def _given(self) -> dict[str, Any]:
        values = {name: getattr(self, name) for name in _GROUP_FILES}
        return {name: value for name, value in values.items() if value not in (None, ())}

    def files(self) -> dict[str, str]:
        """Return the line of each file of the group, in the order in which they are written."""
        return {
            _GROUP_FILES[name]: cpu_text(value) if name == "cpuset" else str(_plain(value))
            for name, value in self._given().items()
        }

    def controllers(self) -> frozenset[str]:
        return frozenset(file.partition(".")[0] for file in self.files())

    def described(self) -> dict[str, object]:
        """Return the limits as values for JSON, by the keys of the configuration."""
        return {name: _plain(value) for name, value in self._given().items()}


NO_LIMITS: Final = GroupLimits()
LIMIT_KEYS: Final = frozenset(GroupLimits.__struct_fields__)
"""As they are called in the configuration."""


class GroupPolicy(Struct, frozen=True, kw_only=True):
    """Whether processes have control groups, and where these are."""

    enabled: bool | None = None
    """None: where any limit is set."""
    base_path: Path | None = None
    """Group below which they are made; None: the one that play-launch runs in, if delegated."""
    required: bool = False
    """Whether nothing starts without its group and its limits."""


class SchedulerPolicy(StrEnum):
    """See sched(7)."""

    OTHER = "other"
    BATCH = "batch"
    IDLE = "idle"
    FIFO = "fifo"
    RR = "rr"

    @property
    def is_real_time(self) -> bool:
        return self in {SchedulerPolicy.FIFO, SchedulerPolicy.RR}


POLICY_NUMBERS: Final = {
    SchedulerPolicy.OTHER: 0,
    SchedulerPolicy.FIFO: 1,
    SchedulerPolicy.RR: 2,
    SchedulerPolicy.BATCH: 3,
    SchedulerPolicy.IDLE: 5,
}


class Scheduler(Struct, frozen=True):
    """A policy, with a priority from 1 to 99 where it is a real-time one, else 0."""

    policy: SchedulerPolicy
    priority: int = 0

    def __str__(self) -> str:
        return f"{self.policy} {self.priority}" if self.policy.is_real_time else str(self.policy)


class IoClass(IntEnum):
    """See ioprio_set(2)."""

    NONE = 0
    """Derived from the nice value."""
    REALTIME = 1
    BEST_EFFORT = 2
    IDLE = 3


class IoPriority(Struct, frozen=True):
    """A class, with a level from 0 (first) to 7 but for the class idle."""

    io_class: IoClass
    level: int = 0

    @property
    def number(self) -> int:
        return self.io_class << _IO_CLASS_SHIFT | self.level

    @classmethod
    def of_number(cls, number: int) -> IoPriority:
        return cls(IoClass(number >> _IO_CLASS_SHIFT & 3), number & 7)

    def __str__(self) -> str:
        name = self.io_class.name.lower()
        has_level = self.io_class in {IoClass.REALTIME, IoClass.BEST_EFFORT}
        return f"{name}:{self.level}" if has_level else name


class ResourceLimit(Struct, frozen=True):
    """A limit of setrlimit(2) by its name in lower case; infinity is unlimited.

    Sizes are bytes, `cpu` is seconds, `rttime` microseconds, and `nice` 20 less the nice value.
    """

    name: str
    soft: float
    hard: float

    @property
    def setting(self) -> str:
        number = getattr(resource, f"RLIMIT_{self.name.upper()}")
        soft, hard = _number(self.soft, _UNLIMITED), _number(self.hard, _UNLIMITED)
        return f"rlimit {number} {soft} {hard}"


class Resources(Struct, frozen=True, kw_only=True):
    """What a process requests; None and empty: what it inherits."""

    nice: int | None = None
    scheduler: Scheduler | None = None
    cpu_affinity: tuple[int, ...] = ()
    """Numbers of CPUs, in order."""
    io_priority: IoPriority | None = None
    oom_score_adj: int | None = None
    lock_memory: bool = False
    rlimits: tuple[ResourceLimit, ...] = ()
    group: GroupLimits = NO_LIMITS

    def __bool__(self) -> bool:
        return self != NO_RESOURCES

    @property
    def limit_names(self) -> tuple[str, ...]:
        return tuple(limit.name for limit in self.rlimits)

    def settings(self) -> tuple[str, ...]:
        """Return all but `lock_memory` and `group`, in the order in which they are applied.

        Limits come first: they decide what of the others is allowed.
        """
        found = [limit.setting for limit in self.rlimits]
        if self.oom_score_adj is not None:
            found.append(f"oom_score_adj {self.oom_score_adj}")
        if self.io_priority is not None:
            found.append(f"io_priority {self.io_priority.number}")
        if self.cpu_affinity:
            found.append(f"cpu_affinity {' '.join(map(str, self.cpu_affinity))}")
        if self.nice is not None:
            found.append(f"nice {self.nice}")
        if self.scheduler is not None:
            number = POLICY_NUMBERS[self.scheduler.policy]
            found.append(f"scheduler {number} {self.scheduler.priority}")
        return tuple(found)

    def described(self) -> dict[str, object]:
        """Return what is requested as values for JSON, by the keys of the configuration."""
        scheduler = self.scheduler
        limits = {
            limit.name: [limit_text(limit.soft), limit_text(limit.hard)] for limit in self.rlimits
        }
        given = {
            "nice": self.nice,
            "scheduler": scheduler
            and {"policy": str(scheduler.policy), "priority": scheduler.priority},
            "cpu_affinity": list(self.cpu_affinity) or None,
            "io_priority": self.io_priority and str(self.io_priority),
            "oom_score_adj": self.oom_score_adj,
            "lock_memory": self.lock_memory or None,
            "rlimits": limits or None,
        }
        own = {name: value for name, value in given.items() if value is not None}
        return own | self.group.described()


NO_RESOURCES: Final = Resources()


def nice_limit(nice: int) -> int:
    """Convert a nice value to what RLIMIT_NICE counts, and back."""
    return _NICE_TO_LIMIT - nice


def limit_text(limit: float) -> int | str:
    return _number(limit, "unlimited")


def _number(limit: float, infinite: _Infinite) -> int | _Infinite:
    return infinite if math.isinf(limit) else int(limit)


def _plain(value: Any) -> list[int] | str | int:
    if isinstance(value, tuple):
        return list(value)
    return str(value) if isinstance(value, CpuMax) else _number(value, "max")


def cpu_text(cpus: Iterable[int]) -> str:
    """Write numbers of CPUs as the kernel does, such as ``0-3,6``."""
    ranges: list[tuple[int, int]] = []
    for cpu in sorted(cpus):
        if ranges and cpu == ranges[-1][1] + 1:
            ranges[-1] = (ranges[-1][0], cpu)
        else:
            ranges.append((cpu, cpu))
    return ",".join(str(low) if low == high else f"{low}-{high}" for low, high in ranges)


def cpus_in(text: str) -> frozenset[int]:
    """Read what `cpu_text` writes; raises ValueError."""
    cpus: set[int] = set()
    for part in text.strip().split(","):
        if part:
            low, _, high = part.partition("-")
            cpus |= set(range(int(low), int(high or low) + 1))
    return frozenset(cpus)
