"""What the limits of its group have to do with the end of a process: counts of the kernel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.config.resources import NO_LIMIT

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.process.cgroups.group import Group

_EVENTS: Final = "memory.events"
_PROCESSES: Final = "pids.events"
_UNITS: Final = (
    *(("GiB", 2**30), ("MiB", 2**20), ("KiB", 2**10)),
    *(("GB", 10**9), ("MB", 10**6), ("kB", 10**3), ("B", 1)),
)


def why_killed(group: Group) -> str:
    """Return the cause of an OOM kill in a group; empty without one."""
    return memory_reason(group.numbers(_EVENTS), group.limits.memory_max)


def why_failed(group: Group) -> str:
    """Return the failures to start processes or threads in a group; empty without any."""
    events = group.numbers(f"{_PROCESSES}.local") or group.numbers(_PROCESSES)
    return processes_reason(events, group.limits.pids_max)


def processes_reason(events: Mapping[str, int], limit: float | None) -> str:
    """Put the numbers of ``pids.events`` into words.

    Args:
        events: They count since the group was made.
        limit: Its own pids.max; None and infinity: none.
    """
    hits = events.get("max", 0)
    if not hits or limit in {None, NO_LIMIT}:
        return ""
    times = "once" if hits == 1 else f"{hits} times"
    return f"pids_max {limit:.0f} of its control group was reached {times}; fix: a larger one"


def memory_reason(events: Mapping[str, int], limit: float | None) -> str:
    """Put the numbers of ``memory.events`` into words.

    Args:
        events: They count since the group was made.
        limit: Its own memory.max in bytes; None and infinity: none.
    """
    if not events.get("oom_kill"):
        return ""
    if not events.get("oom") or limit in {None, NO_LIMIT}:
        return (
            "killed by the kernel: out of memory, not by a limit of its own control group but of "
            "one above, or of the machine"
        )
    assert limit is not None
    return f"killed by the kernel: memory.max {_size(limit)} of its control group"


def _size(number: float) -> str:
    """Write a size in the unit that people gave it in, most likely."""
    whole = [f"{number / size:.0f} {unit}" for unit, size in _UNITS if number % size == 0]
    return min(whole, key=len)
