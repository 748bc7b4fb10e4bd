"""The recording itself: interrupted, without an end, or ended by a full disk."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.postmortem.findings import Finding
from play_launch.postmortem.known_causes import known_cause
from play_launch.postmortem.samples import LITTLE_DISK

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.timeline import Timeline
    from play_launch.supervisor.events import RecordingInterrupted


def detect(timeline: Timeline) -> Iterator[Finding]:
    causes: dict[str, list[RecordingInterrupted]] = {}
    for each in timeline.interruptions:
        causes.setdefault(each.reason, []).append(each)
    for cause, events in causes.items():
        yield Finding(
            kind="interrupted",
            rank=1,
            says="The recording was interrupted {when}",
            times_ns=tuple(each.stamp_ns for each in events),
            cause=cause,
            known=known_cause(cause, ()),
            done=tuple(dict.fromkeys(map(_resumed, events))),
        )
    reader = timeline.session.reader
    if reader.is_complete:
        return
    free = timeline.samples.disk_free_at_the_end()
    if free is not None and free.after < LITTLE_DISK:
        yield Finding(
            kind="disk_full",
            rank=1,
            says="The recording ends on a full disk {when}",
            times_ns=(free.end_ns,),
            cause=str(free),
            trends=(free,),
        )
    if reader.counts:
        yield Finding(
            kind="unfinished",
            rank=7,
            is_failure=False,
            says="The recording is incomplete and ends {at}: play-launch was killed, or still runs",
            times_ns=(reader.end or timeline.session.started_ns,),
        )


def _resumed(event: RecordingInterrupted) -> str:
    return f"it resumed after {event.lasted_ns / 1e9:.1f} s, {event.lost or 'no data lost'}"
