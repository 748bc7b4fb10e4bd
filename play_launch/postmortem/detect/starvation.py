"""Units that used the processor so much that others waited for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.durations import duration
from play_launch.postmortem.findings import Finding
from play_launch.postmortem.samples import Quantity, name_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.samples import Starvation
    from play_launch.postmortem.timeline import Timeline


def detect(timeline: Timeline) -> Iterator[Finding]:
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
