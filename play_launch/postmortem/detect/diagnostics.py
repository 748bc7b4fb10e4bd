"""What nodes themselves report as wrong: errors on `/diagnostics`, and silence."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.config.text import duration
from play_launch.postmortem.diagnostics import ERROR, LEVELS
from play_launch.postmortem.findings import DeclaredPlace, Finding

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.postmortem.diagnostics import Status
    from play_launch.postmortem.timeline import Timeline

_STALE_AFTER: Final = 30_000_000_000
"""Nanoseconds without a report, as other tools have it."""


def detect(timeline: Timeline) -> Iterator[Finding]:
    for name, status in timeline.diagnostics.statuses.items():
        # A status is at most one finding of a kind, whatever its levels.
        yield from _bad(name, status)
        silent_ns = timeline.session.reader.end - status.seen_ns
        if silent_ns > _STALE_AFTER:
            yield Finding(
                kind="diagnostics_silent",
                rank=7,
                is_failure=False,
                says="was not reported any more after {at}",
                name=_named(name, status),
                times_ns=(status.seen_ns,),
                cause=f"the last {duration(silent_ns)} of the recording have no report of it",
            )


def _bad(name: str, status: Status) -> Iterator[Finding]:
    ends = [*(each.at_ns for each in status.changes[1:]), None]
    bad = [
        (change, end)
        for change, end in zip(status.changes, ends, strict=True)
        if change.level >= ERROR
    ]
    if not bad:
        return
    first, end = bad[0]
    level = LEVELS[first.level] if first.level < len(LEVELS) else f"level {first.level}"
    lasted = "until the end" if end is None else f"for {duration(end - first.at_ns)}"
    yield Finding(
        kind="diagnostics_error",
        rank=5,
        is_failure=any(change.level == ERROR for change, _ in bad),
        says=f"was reported as {level} {{when}}",
        name=_named(name, status),
        times_ns=tuple(change.at_ns for change, _ in bad),
        cause=f"{first.message or 'no message'}, {lasted}",
        place=DeclaredPlace(),
    )


def _named(name: str, status: Status) -> str:
    return f"{name} ({status.hardware})" if status.hardware else name
