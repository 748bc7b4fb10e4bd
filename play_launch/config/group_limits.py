"""Limits of control groups (cgroup v2), and which units have one.

The files are those of the kernel's documentation, Control Group v2: each takes one line.
"""

from __future__ import annotations

import math
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
