"""What groups come to is the sum of the last numbers of each."""

from __future__ import annotations

from dataclasses import dataclass

from hypothesis import given
from hypothesis import strategies as st

from play_launch.cli.run import GroupTotal, GroupTotals
from play_launch.supervisor.events import GroupSample, SubjectKind


def sample(at: int, group: int, number: int, key: str = "/a") -> GroupSample:
    return GroupSample(
        stamp_ns=at,
        kind=SubjectKind.PROCESS,
        key=key,
        group=group,
        cpu_seconds=float(number),
        throttled_periods=number,
        throttled_seconds=float(number),
        cpu_pressure=0.0,
        memory_pressure=0.0,
        io_pressure=0.0,
        memory_bytes=0,
        processes=1,
        oom_kills=number,
        pids_max_hits=number,
    )


@dataclass
class Life:
    """One group: the numbers that its samples have, in order."""

    numbers: list[int]


lives = st.lists(
    st.lists(st.integers(0, 50), min_size=1, max_size=4).map(lambda found: Life(sorted(found))),
    min_size=1,
    max_size=5,
)


@given(lives, st.data())
def test_the_last_sample_of_each_group_counts(groups: list[Life], data: st.DataObject) -> None:
    samples = [
        sample(0, group, number) for group, life in enumerate(groups) for number in life.numbers
    ]
    totals = GroupTotals()
    taken: list[GroupSample] = []
    for at, one in enumerate(samples):
        taken.append(sample(at, one.group, one.oom_kills))
        totals.add(taken[-1])
        # One that was taken before may come after it.
        totals.add(data.draw(st.sampled_from(taken)))
    (total,) = totals.get().values()
    expected = sum(life.numbers[-1] for life in groups)
    assert total == GroupTotal(
        cpu_seconds=expected,
        throttled_periods=expected,
        throttled_seconds=expected,
        oom_kills=expected,
        pids_max_hits=expected,
    )
    assert total.is_throttled == bool(expected)
