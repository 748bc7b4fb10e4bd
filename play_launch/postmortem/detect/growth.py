"""Units that use more and more of what is limited, and did not fail of it yet."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.postmortem.findings import Finding
from play_launch.postmortem.samples import Trend, name_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.timeline import Timeline


def detect(timeline: Timeline) -> Iterator[Finding]:
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
