"""Usage of the control groups of processes."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.process.cgroups.group import CONTAINER, Group
from play_launch.process.cgroups.usage import GroupUsage, group_of, usage_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from play_launch.process.sampling.processes import Target
    from play_launch.supervisor.events import GroupSample

PERIOD: Final = 5.0
"""Seconds between two samples of a group, whose numbers the kernel sums up."""
_ATTEMPTS: Final = 3
"""A process may be sampled before it has entered its group."""


class _KnownGroup(Struct):
    group: Group
    number: int
    due: float
    kills: int = 0
    hits: int = 0


class GroupSampler:
    """Samples groups, and reports what their limits did. It belongs to one thread at a time."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._known: dict[Target, _KnownGroup | int] = {}
        """For a process without a group, the remaining attempts to find it."""

    def sample(
        self, targets: Sequence[Target], stamp_ns: int
    ) -> tuple[list[GroupSample], list[str]]:
        """Return samples of the groups that are due, and new OOM kills and hits of pids_max."""
        now = self._clock()
        before, self._known = self._known, {}
        samples: list[GroupSample] = []
        news: list[str] = []
        seen: set[Path] = set()
        for target in targets:
            known = self._known[target] = _found(target, before.get(target, _ATTEMPTS), now)
            # A node that is not in its group is in that of its container, which comes first.
            if isinstance(known, int) or known.group.path in seen:
                continue
            seen.add(known.group.path)
            if now < known.due:
                continue
            usage = usage_of(known.group)
            if usage == GroupUsage():
                continue  # removed
            known.due = now + PERIOD
            samples.append(usage.sample(stamp_ns, target.kind, target.key, known.number))
            if usage.oom_kills or usage.pids_max_hits:
                news += _news(target.key, known)
        return samples, news


def _found(target: Target, known: _KnownGroup | int, now: float) -> _KnownGroup | int:
    if isinstance(known, _KnownGroup) or known == 0:
        return known
    group = group_of(target.pid)
    number = group.number if group is not None else 0
    return known - 1 if group is None or not number else _KnownGroup(group, number, now)


def _news(name: str, known: _KnownGroup) -> Iterator[str]:
    """Report increments of the group itself: that of a container includes its nodes."""
    group = known.group
    kills = sum(
        each.numbers("memory.events.local").get("oom_kill", 0)
        for each in (group, Group(group.path / CONTAINER))
    )
    events = group.numbers("pids.events.local") or group.numbers("pids.events")
    hits = events.get("max", 0)
    if kills > known.kills:
        yield f"{name}: the kernel killed {kills - known.kills} processes of its control group: OOM"
    if hits > known.hits:
        yield (
            f"{name}: {hits - known.hits} processes or threads could not be started: "
            f"pids_max {group.text('pids.max').strip()} of its control group is reached"
        )
    known.kills, known.hits = kills, hits
