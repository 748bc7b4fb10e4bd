"""What a control group uses and was kept from, by the numbers of the kernel."""

from __future__ import annotations

import math
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import asdict

from play_launch.process.cgroups.base import GroupError, own_hierarchy
from play_launch.process.cgroups.group import Group
from play_launch.process.cgroups.names import CONTAINER, SessionName
from play_launch.supervisor.events import GroupSample

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.supervisor.events import SubjectKind

_MICROSECONDS: Final = 1e6
_AVERAGE: Final = re.compile(r"^some avg10=([0-9.]+)", re.MULTILINE)


class GroupUsage(Struct, frozen=True, kw_only=True):
    """Since the group was made; None where its controller is not enabled, or the kernel has none.

    Pressure is the percentage of the latest 10 s in which some of its threads waited.
    """

    cpu_seconds: float | None = None
    """Of all that was in it, and in the groups below."""
    throttled_periods: int | None = None
    """In which ``cpu_max`` held it back."""
    throttled_seconds: float | None = None
    cpu_pressure: float | None = None
    memory_pressure: float | None = None
    io_pressure: float | None = None
    memory_bytes: int | None = None
    processes: int | None = None
    """And threads."""
    oom_kills: int | None = None
    pids_max_hits: int | None = None
    """Processes and threads that could not be started because of ``pids_max``."""

    def described(self) -> dict[str, object]:
        """Give it as values for JSON."""
        return asdict(self)

    def sample(self, stamp_ns: int, kind: SubjectKind, key: str, group: int) -> GroupSample:
        """Give it as an event about the one that has the group of that number."""
        numbers = {name: 0 if value is None else value for name, value in asdict(self).items()}
        for name in ("cpu_pressure", "memory_pressure", "io_pressure"):
            value: float | None = getattr(self, name)
            numbers[name] = math.nan if value is None else value
        return GroupSample(stamp_ns=stamp_ns, kind=kind, key=key, group=group, **numbers)

    def __str__(self) -> str:
        parts = [f"{self.cpu_seconds or 0:.2f} s of CPU time"]
        if self.throttled_periods:
            held = f"{self.throttled_seconds or 0:.2f} s"
            parts.append(f"held back by cpu_max in {self.throttled_periods} periods, {held}")
        if self.oom_kills:
            parts.append(f"{self.oom_kills} killed (OOM)")
        if self.pids_max_hits:
            parts.append(f"pids_max reached {self.pids_max_hits} times")
        return ", ".join(parts)


def usage_of(group: Group) -> GroupUsage:
    """Read it, in some 100 us."""
    cpu = group.numbers("cpu.stat")
    return GroupUsage(
        cpu_seconds=_seconds(cpu, "usage_usec"),
        throttled_periods=cpu.get("nr_throttled"),
        throttled_seconds=_seconds(cpu, "throttled_usec"),
        cpu_pressure=_pressure(group.text("cpu.pressure")),
        memory_pressure=_pressure(group.text("memory.pressure")),
        io_pressure=_pressure(group.text("io.pressure")),
        memory_bytes=_number(group.text("memory.current")),
        processes=_number(group.text("pids.current")),
        oom_kills=group.numbers("memory.events").get("oom_kill"),
        pids_max_hits=group.numbers("pids.events").get("max"),
    )


def group_of(pid: int) -> Group | None:
    """Find the group of a member or a node by its process; None: it has none of ours."""
    try:
        text = Path("/proc", str(pid), "cgroup").read_text()
        mount = _mount()
    except (OSError, GroupError):
        return None
    own = next((line[3:] for line in text.splitlines() if line.startswith("0::")), "")
    parts = own.split("/")
    sessions = [index for index, part in enumerate(parts) if SessionName.parsed(part)]
    # What is not below our own root is of no use, nor is what was removed.
    if not sessions or ".." in parts or own.endswith(" (deleted)"):
        return None
    names = parts[1:]
    if names[-1] == CONTAINER:  # what is said of a container is said of its nodes as well
        names.pop()
    group = Group(mount.joinpath(*names))
    return group if group.path.is_dir() else None


@cache
def _mount() -> Path:
    return own_hierarchy().mount


def _seconds(numbers: Mapping[str, int], name: str) -> float | None:
    return numbers[name] / _MICROSECONDS if name in numbers else None


def _number(text: str) -> int | None:
    return int(text) if text[:1].isdigit() else None


def _pressure(text: str) -> float | None:
    found = _AVERAGE.search(text)  # the kernel may have none, or was started without
    return float(found[1]) if found else None
