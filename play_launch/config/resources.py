"""What a process asks of the kernel for itself: scheduling, CPUs, limits, and its control group.

All but the control group is inherited by the threads and processes that it starts.
`Resources.settings` is what ``container_native/src/base/resource_setting.hpp`` reads. The files of
control groups (see the kernel's documentation, Control Group v2) are written by
`play_launch.process.cgroups`.
"""

from __future__ import annotations

import math
import resource
from enum import IntEnum, StrEnum
from pathlib import Path  # noqa: TC003 - as in `play_launch.config.model`
from typing import TYPE_CHECKING, Final

from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


NO_LIMIT: Final = math.inf
_MAX: Final = "max"
_PERCENT: Final = 100


class CpuMax(Struct, frozen=True):
    """CPU time in each period, of all CPUs together, in microseconds; infinity: any."""

    quota: float
    period: int = 100_000

    @property
    def percent(self) -> float:
        """The share of one CPU; 200 is two CPUs."""
        return _PERCENT * self.quota / self.period

    def __str__(self) -> str:
        return f"{_number(self.quota)} {self.period}"


class GroupLimits(Struct, frozen=True, kw_only=True):
    """What is asked for; None and empty: nothing. Memory is in bytes, infinity is no limit."""

    cpu_max: CpuMax | None = None
    cpu_weight: int | None = None
    cpuset: tuple[int, ...] = ()
    """Numbers of CPUs, in order."""
    io_weight: int | None = None
    pids_max: float | None = None
    memory_high: float | None = None
    memory_max: float | None = None

    def __bool__(self) -> bool:
        """Whether anything is asked for."""
        return self != NO_LIMITS

    def files(self) -> dict[str, str]:
        """Give what is written into each file of the group, in the order in which that is done."""
        return dict(self._files())

    def _files(self) -> Iterator[tuple[str, str]]:
        if self.cpuset:
            yield "cpuset.cpus", cpu_text(self.cpuset)
        if self.cpu_weight is not None:
            yield "cpu.weight", str(self.cpu_weight)
        if self.cpu_max is not None:
            yield "cpu.max", str(self.cpu_max)
        if self.io_weight is not None:
            yield "io.weight", str(self.io_weight)
        if self.pids_max is not None:
            yield "pids.max", _number(self.pids_max)
        if self.memory_high is not None:
            yield "memory.high", _number(self.memory_high)
        if self.memory_max is not None:
            yield "memory.max", _number(self.memory_max)

    def controllers(self) -> frozenset[str]:
        """Name the controllers that have these files."""
        return frozenset(file.partition(".")[0] for file, _ in self._files())

    def described(self) -> dict[str, object]:
        """Give what is asked for as values for JSON, by the keys of the configuration."""
        given = {
            "cpu_max": self.cpu_max and str(self.cpu_max),
            "cpu_weight": self.cpu_weight,
            "cpuset": list(self.cpuset) or None,
            "io_weight": self.io_weight,
            "pids_max": _plain(self.pids_max),
            "memory_high": _plain(self.memory_high),
            "memory_max": _plain(self.memory_max),
        }
        return {name: value for name, value in given.items() if value is not None}


NO_LIMITS: Final = GroupLimits()
LIMIT_KEYS: Final = frozenset(GroupLimits.__struct_fields__)
"""As they are called in the configuration."""


class GroupPolicy(Struct, frozen=True, kw_only=True):
    """Whether processes have control groups, and where these are."""

    enabled: bool | None = None
    """None: where any limit is asked for."""
    base_path: Path | None = None
    """The group below which they are made; None: the one that play-launch runs in, if delegated."""
    required: bool = False
    """Whether nothing starts without its group and its limits."""

    def described(self) -> dict[str, object]:
        """Give it as values for JSON."""
        return {
            "enabled": self.enabled,
            "base_path": None if self.base_path is None else str(self.base_path),
            "required": self.required,
        }


def _number(limit: float) -> str:
    return _MAX if math.isinf(limit) else str(int(limit))


def _plain(limit: float | None) -> int | str | None:
    if limit is None:
        return None
    return _MAX if math.isinf(limit) else int(limit)


def cpu_text(cpus: Iterable[int]) -> str:
    """Write them."""
    ranges: list[tuple[int, int]] = []
    for cpu in sorted(cpus):
        if ranges and cpu == ranges[-1][1] + 1:
            ranges[-1] = (ranges[-1][0], cpu)
        else:
            ranges.append((cpu, cpu))
    return ",".join(str(low) if low == high else f"{low}-{high}" for low, high in ranges)


def cpus_in(text: str) -> frozenset[int]:
    """Read them; raises ValueError."""
    cpus: set[int] = set()
    for part in text.strip().split(","):
        if part:
            low, _, high = part.partition("-")
            cpus |= set(range(int(low), int(high or low) + 1))
    return frozenset(cpus)


_UNLIMITED: Final = 2**64 - 1
_IO_CLASS_SHIFT: Final = 13
_NICE_TO_LIMIT: Final = 20


class SchedulerPolicy(StrEnum):
    """See sched(7)."""

    OTHER = "other"
    BATCH = "batch"
    IDLE = "idle"
    FIFO = "fifo"
    RR = "rr"

    @property
    def is_real_time(self) -> bool:
        """Whether it has priorities, and goes before all threads of other policies."""
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
        """As the kernel has it."""
        return self.io_class << _IO_CLASS_SHIFT | self.level

    @classmethod
    def of_number(cls, number: int) -> IoPriority:
        """Read what the kernel gives."""
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
    def number(self) -> int:
        """Which one it is for the kernel."""
        number: int = getattr(resource, f"RLIMIT_{self.name.upper()}")
        return number


class Resources(Struct, frozen=True, kw_only=True):
    """What is asked for; None and empty: what the process has anyway."""

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
        """Whether anything is asked for."""
        return self != NO_RESOURCES

    @property
    def limit_names(self) -> tuple[str, ...]:
        """Which limits are asked for."""
        return tuple(limit.name for limit in self.rlimits)

    def settings(self) -> tuple[str, ...]:
        """Write all but `lock_memory` and `group`, in the order in which they are applied.

        Limits come first: they decide what of the others is allowed.
        """
        return tuple(self._settings())

    def _settings(self) -> Iterator[str]:
        for limit in self.rlimits:
            soft, hard = _kernel_limit(limit.soft), _kernel_limit(limit.hard)
            yield f"rlimit {limit.number} {soft} {hard}"
        if self.oom_score_adj is not None:
            yield f"oom_score_adj {self.oom_score_adj}"
        if self.io_priority is not None:
            yield f"io_priority {self.io_priority.number}"
        if self.cpu_affinity:
            yield f"cpu_affinity {' '.join(map(str, self.cpu_affinity))}"
        if self.nice is not None:
            yield f"nice {self.nice}"
        if self.scheduler is not None:
            number = POLICY_NUMBERS[self.scheduler.policy]
            yield f"scheduler {number} {self.scheduler.priority}"

    def described(self) -> dict[str, object]:
        """Give what is asked for as values for JSON, by the keys of the configuration."""
        given = {
            "nice": self.nice,
            "scheduler": self.scheduler
            and {"policy": str(self.scheduler.policy), "priority": self.scheduler.priority},
            "cpu_affinity": list(self.cpu_affinity) or None,
            "io_priority": self.io_priority and str(self.io_priority),
            "oom_score_adj": self.oom_score_adj,
            "lock_memory": self.lock_memory or None,
            "rlimits": {
                limit.name: [limit_text(limit.soft), limit_text(limit.hard)]
                for limit in self.rlimits
            }
            or None,
        }
        own = {name: value for name, value in given.items() if value is not None}
        return own | self.group.described()


NO_RESOURCES: Final = Resources()


def nice_limit(nice: int) -> int:
    """Convert a nice value to what RLIMIT_NICE counts, and back."""
    return _NICE_TO_LIMIT - nice


def limit_text(limit: float) -> int | str:
    """Write a limit for people and JSON."""
    return "unlimited" if math.isinf(limit) else int(limit)


def _kernel_limit(limit: float) -> int:
    return _UNLIMITED if math.isinf(limit) else int(limit)
