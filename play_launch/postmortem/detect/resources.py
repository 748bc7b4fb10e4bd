"""Units that use too much: limited or killed by their control groups, growing, starving others."""

from __future__ import annotations

from bisect import bisect_left
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.config.text import duration
from play_launch.postmortem.findings import Finding
from play_launch.postmortem.samples import Growth, Quantity, Trend, grown, name_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.samples import BusyTime, Rate, Samples
    from play_launch.postmortem.timeline import Timeline

_THROTTLED: Final = 0.1
"""Share of the time in which a unit may be throttled without being named."""
_SECOND: Final = 1_000_000_000
_LEAKS: Final = {
    Quantity.MEMORY: Growth(2.0, 128_000_000),
    Quantity.THREADS: Growth(4.0, 100),
    Quantity.DESCRIPTORS: Growth(4.0, 200),
}
_RISE: Final = dict.fromkeys(_LEAKS, Growth(1.1, 1))
"""In the second half of the time that counts."""
_LEAK_SAMPLES: Final = 30
_HOG: Final = 40.0
"""Percent of one core: two that want the same one get half of it each."""
_PREEMPTED: Final = 10.0
"""Involuntary context switches per second of a starved unit, at least."""
_MOST_HIT: Final = 3


class _Starvation(NamedTuple):
    """A time in which a unit used a core that others waited for."""

    busy: BusyTime
    hog: Rate
    hit: list[Rate]


def detect(timeline: Timeline) -> Iterator[Finding]:
    yield from _limited(timeline)
    yield from _growing(timeline)
    yield from _starving(timeline)


def _limited(timeline: Timeline) -> Iterator[Finding]:
    for key, group in timeline.groups.items():
        name = name_of(key)
        if group.oom_times:
            yield Finding(
                kind="oom",
                rank=1,
                says="exceeded its memory limit, and the kernel killed processes of it {when}",
                name=name,
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
                name=name,
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
                name=name,
                key=key,
                times_ns=(group.throttled_ns,),
                cause=f"cpu_max stopped it for {duration(throttled)} in {duration(lasted)}",
            )


def _growing(timeline: Timeline) -> Iterator[Finding]:
    failed = {each.key for each in timeline.failures}
    for key in timeline.samples.units():
        trends = [] if key in failed else list(_leaks(timeline.samples, key))
        if not trends:
            continue
        text = " and ".join(map(str, trends))
        yield Finding(
            kind="grew",
            rank=6,
            says=f"may leak: {text}, still rising at the end",
            name=name_of(key),
            key=key,
            times_ns=(trends[0].begin_ns,),
            trends=tuple(trends),
        )


def _leaks(samples: Samples, key: str) -> Iterator[Trend]:
    """Give what grew in the process that lives at the end."""
    life = samples.life(key)
    if len(life) <= _LEAK_SAMPLES:
        return
    begin_ns, lasted = life[0].time, life[-1].time - life[0].time
    # What a node takes while it starts is no leak.
    begin, middle = (
        life[bisect_left(life, begin_ns + lasted * share // 20, key=lambda tick: tick.time)].of(key)
        for share in (2, 11)
    )
    last = life[-1].of(key)
    rising = {each.quantity for each in grown(middle, last, "", _RISE)}
    yield from (
        each for each in grown(begin, last, name_of(key), _LEAKS) if each.quantity in rising
    )


def _starving(timeline: Timeline) -> Iterator[Finding]:
    found: dict[str, list[_Starvation]] = {}
    for busy in timeline.samples.busy_times():
        hog = max(busy.rates, key=lambda rate: rate.cpu, default=None)
        if hog is None or hog.cpu < _HOG:
            continue
        hit = [each for each in busy.rates if each is not hog and each.preempted >= _PREEMPTED]
        if hit:
            hit = sorted(hit, key=lambda rate: -rate.preempted)[:_MOST_HIT]
            found.setdefault(hog.key, []).append(_Starvation(busy, hog, hit))
    for key, times in found.items():
        often = ", " if len(times) == 1 else f" {len(times)} times, first "
        first = times[0]
        yield Finding(
            kind="starved",
            rank=3,
            says=f"starved others of CPU time{often}from {{at}} on",
            name=name_of(key),
            key=key,
            times_ns=tuple(each.busy.begin_ns for each in times),
            cause=_cause(first),
            hit=tuple(name_of(each.key) for each in first.hit),
            trends=tuple(_trends(first)),
        )


def _trends(found: _Starvation) -> Iterator[Trend]:
    begin_ns, end_ns = found.busy.begin_ns, found.busy.end_ns
    for key, quantity, value in (
        (found.hog.key, Quantity.PROCESSOR, found.hog.cpu),
        *((each.key, Quantity.WAITING, each.preempted) for each in found.hit),
        ("", Quantity.PRESSURE, found.busy.pressure),
    ):
        yield Trend(name_of(key), quantity, 0.0, value, begin_ns, end_ns)


def _cause(found: _Starvation) -> str:
    busy = found.busy
    hit = (f"{name_of(each.key)} ({each.preempted:.0f} times a second)" for each in found.hit)
    text = f"it used {found.hog.cpu:.0f} % of a core for {duration(busy.end_ns - busy.begin_ns)}"
    text += f", and {', '.join(hit)} had to wait for one"
    if busy.pressure > 0:
        text += f"; {busy.pressure:.0f} % of the time something waited for a core"
    return text
