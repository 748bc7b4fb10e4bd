"""Units that fail again and again soon after each restart."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.config.durations import duration
from play_launch.postmortem.declared import DeclaredPlace
from play_launch.postmortem.findings import Finding
from play_launch.postmortem.units import Fault

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.timeline import Timeline

_FAILURES: Final = 5
_WITHIN: Final = 60_000_000_000
"""Nanoseconds for so many."""
_ENDS: Final = frozenset({Fault.CRASHED, Fault.DIED, Fault.KILLED})


def detect(timeline: Timeline) -> Iterator[Finding]:
    times: dict[str, list[int]] = {}
    units = {unit.key: unit for unit in timeline.units}
    for each in timeline.failures:
        if each.fault in _ENDS:
            times.setdefault(each.key, []).extend(each.times)
    for key, every in times.items():
        every.sort()
        loops = (
            begin
            for begin, end in zip(every, every[_FAILURES - 1 :], strict=False)
            if end - begin <= _WITHIN
        )
        first = next(loops, None)
        if first is None:
            continue
        unit = units[key]
        count = sum(first <= at <= first + _WITHIN for at in every)
        lasted = max(at for at in every if at <= first + _WITHIN) - first
        yield Finding(
            kind="restart_loop",
            rank=2,
            says="was restarted in a loop, from {at} on",
            who=unit.name,
            key=key,
            times_ns=(first,),
            cause=f"it failed {count} times within {duration(lasted)}",
            place=DeclaredPlace(container=unit.container),
        )
