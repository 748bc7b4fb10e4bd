"""What nodes themselves report as wrong: errors on `/diagnostics`, and silence."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.text import duration
from play_launch.postmortem.diagnostics import ERROR, level_name
from play_launch.postmortem.findings import DeclaredPlace, Finding

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from play_launch.postmortem.diagnostics import LevelChange
    from play_launch.postmortem.timeline import Timeline


def detect(timeline: Timeline) -> Iterator[Finding]:
    for status in timeline.diagnostics.statuses.values():
        # A status is at most one finding of a kind, whatever its levels.
        ends = [*(each.at_ns for each in status.changes[1:]), None]
        stays = list(zip(status.changes, ends, strict=True))
        if bad := [stay for stay in stays if stay[0].level >= ERROR and not stay[0].is_silence]:
            yield _bad(bad, status.further_changes)
        if silent := [stay for stay in stays if stay[0].is_silence]:
            yield _silent(silent, timeline)


def _bad(bad: Sequence[tuple[LevelChange, int | None]], further: int) -> Finding:
    first, end = bad[0]
    more = f"; {further} later changes of its level are not counted" if further else ""
    lasted = "until the end" if end is None else f"for {duration(end - first.at_ns)}"
    return Finding(
        kind="diagnostics_error",
        rank=5,
        is_failure=any(change.level == ERROR for change, _ in bad),
        says=f"was reported as {level_name(first.level)} {{when}}",
        name=first.name,
        times_ns=tuple(change.at_ns for change, _ in bad),
        cause=f"{first.message or 'no message'}, {lasted}{more}",
        place=DeclaredPlace(),
    )


def _silent(silent: Sequence[tuple[LevelChange, int | None]], timeline: Timeline) -> Finding:
    stale_ns, end_ns = timeline.diagnostics.stale_ns, timeline.session.reader.end
    begins = [change.at_ns - stale_ns for change, _ in silent]
    longest = max((end or end_ns) - at for (_, end), at in zip(silent, begins, strict=True))
    most, at_last = (" at most", "at last ") if len(silent) > 1 else ("", "")
    last = f", {at_last}until the end" if silent[-1][1] is None else ""
    return Finding(
        kind="diagnostics_silent",
        rank=7,
        is_failure=False,
        says="fell silent {when}",
        name=silent[0][0].name,
        times_ns=tuple(begins),
        cause=f"no report of it for {duration(longest)}{most}{last}",
    )
