"""What a control group uses and was kept from, by the numbers of the kernel."""

from __future__ import annotations

import logging
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import asdict

from play_launch.cgroups.base import GroupError, own_hierarchy
from play_launch.cgroups.group import Group
from play_launch.cgroups.names import CONTAINER, SessionName

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

_log = logging.getLogger(__name__)
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

    def __str__(self) -> str:
        parts = [f"{self.cpu_seconds or 0:.2f} s of CPU time"]
        if self.throttled_periods:
            held = f"{self.throttled_seconds or 0:.2f} s"
            parts.append(f"held back by cpu_max in {self.throttled_periods} periods, {held}")
        if self.oom_kills:
            parts.append(f"{self.oom_kills} killed for want of memory")
        if self.pids_max_hits:
            parts.append(f"pids_max reached {self.pids_max_hits} times")
        return ", ".join(parts)


def usage_of(group: Group) -> GroupUsage:
    """Read it; takes some ten system calls for each file."""
    cpu = group.numbers("cpu.stat")
    return GroupUsage(
        cpu_seconds=_seconds(cpu, "usage_usec"),
        throttled_periods=cpu.get("nr_throttled"),
        throttled_seconds=_seconds(cpu, "throttled_usec"),
        cpu_pressure=_pressure(group.path / "cpu.pressure"),
        memory_pressure=_pressure(group.path / "memory.pressure"),
        io_pressure=_pressure(group.path / "io.pressure"),
        memory_bytes=_number(group.path / "memory.current"),
        processes=_number(group.path / "pids.current"),
        oom_kills=group.numbers("memory.events").get("oom_kill"),
        pids_max_hits=group.numbers("pids.events").get("max"),
    )


def report_and_remove(group: Group) -> None:
    """Log what a group used all in all, and remove it; nobody is in it any more."""
    if group.path.is_dir():
        _log.info("the control group %s used %s", group.path.name, usage_of(group))
        group.remove()


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


class GroupWatch:
    """Reports what happens to groups: kills for want of memory, and ``pids_max``."""

    def __init__(self) -> None:
        """Nothing was seen yet."""
        self._groups: dict[tuple[str, int, int], Group | None] = {}
        self._seen: dict[Path, tuple[int, int]] = {}

    def look(self, processes: Iterable[tuple[str, int, int]]) -> list[str]:
        """Say what is new about the groups of processes since they were looked at before.

        Args:
            processes: Names, pids, and start times in clock ticks after boot. A process stays in
                its group, so that is looked for once.
        """
        known = self._groups
        self._groups = {
            each: known[each] if each in known else group_of(each[1]) for each in processes
        }
        groups = ((name, group) for (name, _, _), group in self._groups.items() if group)
        return [text for name, group in groups for text in self._news(name, group)]

    def _news(self, name: str, group: Group) -> Iterator[str]:
        # Of the group itself: a container's has those of its nodes below it.
        kills = sum(
            each.numbers("memory.events.local").get("oom_kill", 0)
            for each in (group, Group(group.path / CONTAINER))
        )
        events = group.numbers("pids.events.local") or group.numbers("pids.events")
        hits = events.get("max", 0)
        if not kills and not hits:
            return
        before = self._seen.get(group.path, (0, 0))
        self._seen[group.path] = kills, hits
        if kills > before[0]:
            yield (
                f"{name}: the kernel killed {kills - before[0]} processes of its control group for "
                "want of memory"
            )
        if hits > before[1]:
            limit = _number(group.path / "pids.max")
            yield (
                f"{name}: {hits - before[1]} processes or threads could not be started: "
                f"pids_max {limit} of its control group is reached"
            )


@cache
def _mount() -> Path:
    return own_hierarchy().mount


def _seconds(numbers: Mapping[str, int], name: str) -> float | None:
    return numbers[name] / _MICROSECONDS if name in numbers else None


def _number(file: Path) -> int | None:
    try:
        return int(file.read_text())
    except (OSError, ValueError):
        return None


def _pressure(file: Path) -> float | None:
    try:
        found = _AVERAGE.search(file.read_text())
    except OSError:  # the kernel has none, or was started without
        return None
    return float(found[1]) if found else None
