"""Sums of control groups: the last numbers of each group count."""

from __future__ import annotations

from play_launch.cli.run import GroupTotals
from play_launch.supervisor.events import GroupSample, SubjectKind


def sample(at: int, group: int, number: int, key: str = "/a") -> GroupSample:
    return GroupSample(
        stamp_ns=at,
        kind=SubjectKind.PROCESS,
        key=key,
        group=group,
        cpu_seconds=float(number),
        throttled_periods=0,
        throttled_seconds=0.0,
        cpu_pressure=0.0,
        memory_pressure=0.0,
        io_pressure=0.0,
        memory_bytes=0,
        processes=1,
        oom_kills=number,
        pids_max_hits=0,
    )


def test_the_last_sample_of_each_group_counts() -> None:
    totals = GroupTotals()
    # The second life has another group; a sample of the first one comes late.
    for at, group, number in ((1, 1, 2), (2, 1, 5), (3, 2, 1), (1, 1, 2), (4, 2, 3)):
        totals.add(sample(at, group, number))
    totals.add(sample(1, 1, 0, "/b"))
    found = {key: total for (_, key), total in totals.get().items()}
    assert (found["/a"].oom_kills, found["/a"].cpu_seconds) == (8, 8.0)
    assert (found["/a"].is_throttled, found["/b"].is_throttled) == (True, False)
