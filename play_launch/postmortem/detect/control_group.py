"""Units that the limits of their control groups throttle or kill."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.config.durations import duration
from play_launch.postmortem.findings import Finding
from play_launch.postmortem.samples import name_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.timeline import Timeline

_THROTTLED: Final = 0.1
"""Share of the time in which a unit may be throttled without being named."""
_SECOND: Final = 1_000_000_000


def detect(timeline: Timeline) -> Iterator[Finding]:
    for key, group in timeline.groups.of_units.items():
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
