"""Units that use too much: limited or killed by their control groups, growing, starving others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.config.durations import duration
from play_launch.postmortem.findings import Finding
from play_launch.postmortem.samples import Quantity, Trend, name_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.samples import Starvation
    from play_launch.postmortem.timeline import Timeline

_THROTTLED: Final = 0.1
"""Share of the time in which a unit may be throttled without being named."""
_SECOND: Final = 1_000_000_000


def detect(timeline: Timeline) -> Iterator[Finding]:
    yield from _limited(timeline)
    yield from _growing(timeline)
    yield from _starving(timeline)


def _limited(timeline: Timeline) -> Iterator[Finding]:
    for key, group in timeline.groups.items():
        who = name_of(key)
        if group.oom_times:
            yield Finding(
                kind="oom",
                rank=1,
                says="exceeded its memory limit, and the kernel killed processes of it {when}",
                who=who,
                key=key,
                times_ns=tuple(group.oom_times),
                cause=f"memory.max was reached; processes killed: {group.oom_kills}",
                known="out_of_memory",
            )
        if group.refused_times:
            yield Finding(
                kind="pids_max",
                rank=1,
                says="was refused processes or threads by pids_max {when}",
                who=who,
                key=key,
                times_ns=tuple(group.refused_times),
                cause=f"processes and threads that could not be started: {group.refused}",
            )
        lasted = group.end_ns - group.begin_ns
        throttled = round(group.throttled_seconds * _SECOND)
        if throttled >= max(_SECOND, lasted * _THROTTLED):
            yield Finding(
                kind="throttled",
                rank=5,
                says="was throttled by its CPU limit, first in the 10 s before {at}",
                who=who,
                key=key,
                times_ns=(group.throttled_ns,),
                cause=f"cpu_max stopped it for {duration(throttled)} in {duration(lasted)}",
            )


def _growing(timeline: Timeline) -> Iterator[Finding]:
    failed = {each.key for each in timeline.failures}
    found: dict[str, list[Trend]] = {}
    for key, trend in timeline.samples.leaks():
        if key not in failed:
            found.setdefault(key, []).append(trend)
    for key, trends in found.items():
        text = " and ".join(map(str, trends))
        yield Finding(
            kind="grew",
            rank=6,
            says=f"may leak: {text}, still rising at the end",
            who=name_of(key),
            key=key,
            times_ns=(trends[0].begin_ns,),
            trends=tuple(trends),
        )


def _starving(timeline: Timeline) -> Iterator[Finding]:
    found: dict[str, list[Starvation]] = {}
    for each in timeline.samples.starvations():
        found.setdefault(each.key, []).append(each)
    for key, times in found.items():
        often = ", " if len(times) == 1 else f" {len(times)} times, first "
        yield Finding(
            kind="starved",
            rank=3,
            says=f"starved others of CPU time{often}from {{at}} on",
            who=name_of(key),
            key=key,
            times_ns=tuple(each.begin_ns for each in times),
            cause=_cause(times[0]),
            hit=times[0].hit,
            trends=times[0].trends,
        )


def _cause(starvation: Starvation) -> str:
    by_quantity = {each.quantity: each for each in starvation.trends}
    used, pressure = by_quantity[Quantity.PROCESSOR], by_quantity[Quantity.PRESSURE].after
    waited = [each for each in starvation.trends if each.quantity is Quantity.WAITING]
    names = ", ".join(f"{each.who} ({each.after:.0f} times a second)" for each in waited)
    text = f"it used {used.after:.0f} % of a core for {duration(used.end_ns - used.begin_ns)}"
    text += f", and {names} had to wait for one"
    if pressure > 0:
        text += f"; {pressure:.0f} % of the time something waited for a core"
    return text
