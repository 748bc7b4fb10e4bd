"""What control groups used and were kept from in a whole run, added up from their samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.supervisor.events import GroupSample, SubjectKind


class GroupTotal(Struct, frozen=True, kw_only=True):
    """The sums over all groups that one thing had, one after the other; see `GroupSample`."""

    cpu_seconds: float = 0.0
    throttled_periods: int = 0
    throttled_seconds: float = 0.0
    oom_kills: int = 0
    pids_max_hits: int = 0

    @property
    def is_held_back(self) -> bool:
        """Whether a limit did anything."""
        return bool(self.throttled_periods or self.oom_kills or self.pids_max_hits)

    def plus(self, sample: GroupSample) -> GroupTotal:
        """Add what a group came to."""
        return GroupTotal(
            cpu_seconds=self.cpu_seconds + sample.cpu_seconds,
            throttled_periods=self.throttled_periods + sample.throttled_periods,
            throttled_seconds=self.throttled_seconds + sample.throttled_seconds,
            oom_kills=self.oom_kills + sample.oom_kills,
            pids_max_hits=self.pids_max_hits + sample.pids_max_hits,
        )


class _Sums(Struct):
    last: GroupSample
    before: GroupTotal = GroupTotal()
    """Of the groups before that of the last sample."""


class GroupTotals:
    """Takes the samples of a run; of a group, the last one counts."""

    def __init__(self) -> None:
        """Nothing was used yet."""
        self._sums: dict[tuple[SubjectKind, str], _Sums] = {}

    def take(self, sample: GroupSample) -> None:
        """Take one. One that comes late, taken before another that is here, adds nothing."""
        sums = self._sums.setdefault((sample.kind, sample.key), _Sums(sample))
        if sample.stamp_ns < sums.last.stamp_ns:
            return
        if sample.group != sums.last.group:
            sums.before = sums.before.plus(sums.last)
        sums.last = sample

    def get(self) -> Mapping[tuple[SubjectKind, str], GroupTotal]:
        """Give the sums by kind and key, in the order in which they were seen first."""
        return {whose: sums.before.plus(sums.last) for whose, sums in self._sums.items()}
