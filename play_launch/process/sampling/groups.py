"""Looks at the control groups of processes again and again."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.process.cgroups.group import Group
from play_launch.process.cgroups.names import CONTAINER
from play_launch.process.cgroups.refusals import taken_controller
from play_launch.process.cgroups.usage import GroupUsage, group_of, usage_of, withdrawn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from play_launch.process.sampling.targets import Target
    from play_launch.supervisor.events import GroupSample

PERIOD: Final = 5.0
"""Seconds between two looks at a group that is kept from nothing: what it uses is summed up by the
kernel."""
_LOOKS: Final = 3
"""How often a process is looked for in a group: it may be seen before it has entered its own."""
_NOTHING: Final = GroupUsage()


class _Known(Struct):
    """What is remembered of a group from one look to the next."""

    group: Group
    number: int
    due: float
    """When it is to be looked at, on the monotonic clock."""
    usage: GroupUsage = _NOTHING
    reported: tuple[int, int] = (0, 0)
    """Kills for want of memory and hits of ``pids_max`` that were news before."""


class GroupSampler:
    """Makes samples of groups, and says what is new about them. For one thread at a time."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock`, in seconds, decides when a group is due."""
        self._clock = clock
        self._known: dict[Target, _Known | int] = {}
        """Of a process without a group, how often it is to be looked for."""

    def sample(
        self, targets: Sequence[Target], stamp_ns: int
    ) -> tuple[list[GroupSample], list[str]]:
        """Look at the groups that are due: at rest, each is every `PERIOD` seconds.

        Nothing is read for processes that have no group of their own.

        Returns:
            The samples, and what is new: kills for want of memory, hits of ``pids_max``, and
            controllers that somebody has taken away.
        """
        now = self._clock()
        before, self._known = self._known, {}
        samples: list[GroupSample] = []
        news: list[str] = []
        seen: set[Path] = set()
        for target in targets:
            known = self._known[target] = _looked_for(target, before.get(target, _LOOKS), now)
            # A node that was kept out of its group is in that of its container, which comes first.
            if isinstance(known, int) or known.group.path in seen:
                continue
            seen.add(known.group.path)
            if now < known.due:
                continue
            usage, last = usage_of(known.group), known.usage
            if usage == _NOTHING:
                continue  # it is removed
            known.usage = usage
            news += _taken(target.key, known.group, withdrawn(last, usage))
            known.due = now + (PERIOD if _held_back(usage) == _held_back(last) else 0.0)
            samples.append(usage.sample(stamp_ns, target.kind, target.key, known.number))
            news += _news(target.key, known)
        return samples, news


def _looked_for(target: Target, known: _Known | int, now: float) -> _Known | int:
    if isinstance(known, _Known) or known == 0:
        return known
    group = group_of(target.pid)
    number = group.number if group is not None else 0
    return known - 1 if group is None or not number else _Known(group, number, now)


def _held_back(usage: GroupUsage) -> tuple[int, int, int]:
    """Count what a limit did."""
    return usage.throttled_periods or 0, usage.oom_kills or 0, usage.pids_max_hits or 0


def _taken(name: str, group: Group, controllers: Sequence[str]) -> Iterator[str]:
    for controller in controllers:
        # Not where the group was removed while it was read.
        if controller not in group.text("cgroup.controllers").split() and group.path.is_dir():
            yield f"{name}: {taken_controller(controller)}"


def _news(name: str, known: _Known) -> Iterator[str]:
    if not (known.usage.oom_kills or known.usage.pids_max_hits):
        return
    # Of the group itself: a container's has those of its nodes below it.
    group = known.group
    kills = sum(
        each.numbers("memory.events.local").get("oom_kill", 0)
        for each in (group, Group(group.path / CONTAINER))
    )
    events = group.numbers("pids.events.local") or group.numbers("pids.events")
    hits = events.get("max", 0)
    before, known.reported = known.reported, (kills, hits)
    if kills > before[0]:
        yield (
            f"{name}: the kernel killed {kills - before[0]} processes of its control group for "
            "want of memory"
        )
    if hits > before[1]:
        limit = group.text("pids.max").strip()
        yield (
            f"{name}: {hits - before[1]} processes or threads could not be started: "
            f"pids_max {limit} of its control group is reached"
        )
