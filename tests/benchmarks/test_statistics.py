"""What is kept of many values."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.crash.footprint import Footprint, growth
from benchmarks.statistics import Summary, percentile

values = st.lists(st.floats(-1e9, 1e9), min_size=1)
percents = st.floats(0, 100)


@given(values, percents)
def test_a_percentile_is_one_of_the_values(data: list[float], percent: float) -> None:
    found = percentile(data, percent)
    assert found in data
    not_above = sum(value <= found for value in data)
    assert not_above >= percent / 100 * len(data) - 1e-6
    below = sum(value < found for value in data)
    assert below < percent / 100 * len(data) or below == 0


@given(values, percents, percents)
def test_percentiles_are_in_order(data: list[float], one: float, other: float) -> None:
    low, high = sorted((one, other))
    assert percentile(data, low) <= percentile(data, high)
    assert percentile(data, 0) == min(data)
    assert percentile(data, 100) == max(data)


def test_no_values_have_no_percentile() -> None:
    with pytest.raises(ValueError, match="no values"):
        percentile([], 50)
    assert Summary.of([]) is None


@given(st.lists(st.floats(1e-6, 1e6), min_size=1))
def test_a_summary_survives_its_json(data: list[float]) -> None:
    summary = Summary.of(data)
    assert summary is not None
    again = Summary.from_json(summary.as_json())
    assert again.count == len(data)
    for name in ("min", "p50", "p99", "max"):
        assert getattr(again, name) == pytest.approx(getattr(summary, name), rel=1e-5)


@given(st.integers(3, 50), st.floats(-2, 2), st.lists(st.integers(0, 5), min_size=50, max_size=50))
def test_growth_is_what_stays(count: int, slope: float, passing: list[int]) -> None:
    """A quantity that grows steadily, with something on top that comes and goes."""
    passing[0] = passing[-1] = passing[count - 1] = 0
    taken = [
        Footprint(
            after=10 * i,
            memory=100 + slope * 10 * i,
            threads=4 + passing[i],
            descriptors=20,
            mappings=7,
        )
        for i in range(count)
    ]
    grown = growth(taken)
    assert grown is not None
    assert grown["descriptors"] == grown["mappings"] == 0
    # The thirds are told apart by their smallest values, whose places may be a third off.
    assert grown["memory"] == pytest.approx(1000 * slope, abs=1e-6)


def test_too_few_footprints_tell_nothing() -> None:
    assert growth([]) is None
    assert growth([Footprint(0, 1.0, 1, 1, 1)] * 2) is None
    assert growth([Footprint(5, 1.0, 1, 1, 1)] * 9) is None
