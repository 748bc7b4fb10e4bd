"""What a control group uses and was kept from, by the numbers of the kernel."""

from __future__ import annotations

import math
import re
from functools import cache
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct
from msgspec.structs import asdict

from play_launch.process.cgroups.group import CONTAINER, Group, GroupError, SessionName, path_of
from play_launch.process.cgroups.session_groups import own_hierarchy
from play_launch.supervisor.events import GroupSample

if TYPE_CHECKING:
    from pathlib import Path

    from play_launch.supervisor.events import SubjectKind

_AVERAGE: Final = re.compile(r"^some avg10=([0-9.]+)", re.MULTILINE)


class GroupUsage(Struct, frozen=True, kw_only=True):
    """Since the group was made; None where its controller is not enabled, or the kernel has none.

    Pressure is the percentage of the latest 10 s in which some of its threads waited.
    """

    cpu_seconds: float | None = None
    """Of all that was in it, and in the groups below."""
    throttled_periods: int | None = None
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

    def sample(self, stamp_ns: int, kind: SubjectKind, key: str, group: int) -> GroupSample:
        """Return it as an event about the unit that has the group of that number."""
        numbers: dict[str, Any] = {
            name: (math.nan if name.endswith("_pressure") else 0) if value is None else value
            for name, value in asdict(self).items()
        }
        return GroupSample(stamp_ns=stamp_ns, kind=kind, key=key, group=group, **numbers)

    def __str__(self) -> str:
        parts = [f"{self.cpu_seconds or 0:.2f} s of CPU time"]
        if self.throttled_periods:
            seconds = f"{self.throttled_seconds or 0:.2f} s"
            parts.append(f"throttled by cpu_max in {self.throttled_periods} periods, {seconds}")
        if self.oom_kills:
            parts.append(f"{self.oom_kills} killed (OOM)")
        if self.pids_max_hits:
            parts.append(f"pids_max reached {self.pids_max_hits} times")
        return ", ".join(parts)


def usage_of(group: Group) -> GroupUsage:
    """Read the usage of a group, in some 100 us."""
    cpu = group.numbers("cpu.stat")
    seconds = {name: value / 1e6 for name, value in cpu.items()}
    return GroupUsage(
        cpu_seconds=seconds.get("usage_usec"),
        throttled_periods=cpu.get("nr_throttled"),
        throttled_seconds=seconds.get("throttled_usec"),
        cpu_pressure=_pressure(group.text("cpu.pressure")),
        memory_pressure=_pressure(group.text("memory.pressure")),
        io_pressure=_pressure(group.text("io.pressure")),
        memory_bytes=_number(group.text("memory.current")),
        processes=_number(group.text("pids.current")),
        oom_kills=group.numbers("memory.events").get("oom_kill"),
        pids_max_hits=group.numbers("pids.events").get("max"),
    )


def group_of(pid: int) -> Group | None:
    """Find the group of a member or node by its process; None if it is in none of a session."""
    own = path_of(pid)
    names = own.split("/")[1:]
    # Groups above our own root are not visible, and removed ones have no files.
    if ".." in names or own.endswith(" (deleted)") or not any(map(SessionName.parsed, names)):
        return None
    if names[-1] == CONTAINER:  # a container's figures include those of its nodes
        names.pop()
    try:
        group = Group(_mount().joinpath(*names))
    except GroupError:
        return None
    return group if group.path.is_dir() else None


@cache
def _mount() -> Path:
    return own_hierarchy()[0]


def _number(text: str) -> int | None:
    return int(text) if text[:1].isdigit() else None


def _pressure(text: str) -> float | None:
    found = _AVERAGE.search(text)  # empty for a kernel without pressure stall information
    return float(found[1]) if found else None
