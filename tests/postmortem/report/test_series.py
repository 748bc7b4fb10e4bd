"""Packed columns come back: read by a second implementation, as the page's script has one."""

from __future__ import annotations

import base64
import zlib
from array import array
from math import isfinite, isnan, nan

from hypothesis import given
from hypothesis import strategies as st

from play_launch.postmortem.report.series import (
    MISSING,
    packed,
    quantised,
    time_planes,
    value_planes,
)

STEPS = st.lists(st.lists(st.integers(0, 0xFFFF)), max_size=4)
TIMES = st.lists(st.lists(st.integers(0, 2**31 - 1)), max_size=4)


def numbers_of(planes: bytes, size: int) -> list[int]:
    count = len(planes) // size
    return [sum(planes[p * count + i] << 8 * p for p in range(size)) for i in range(count)]


def test_text_is_compressed_data() -> None:
    data = b"crash " * 1000
    assert zlib.decompress(base64.b64decode(packed(data))) == data
    assert len(packed(data)) < 100


@given(STEPS)
def test_steps_come_back(columns: list[list[int]]) -> None:
    planes = value_planes(array("H", column) for column in columns)
    before, found = 0, []
    for difference in numbers_of(planes, 2):
        before = (before + difference) & 0xFFFF
        found.append(before)
    assert found == [step for column in columns for step in column]


@given(TIMES)
def test_times_come_back_in_whatever_order(columns: list[list[int]]) -> None:
    numbers = iter(numbers_of(time_planes(columns), 4))
    for column in columns:
        before = distance = 0
        for at in column:
            zigzag = next(numbers)
            distance = signed(distance + ((zigzag >> 1) ^ -(zigzag & 1)))
            before = signed(before + distance)
            assert before == at
    assert next(numbers, None) is None


def signed(number: int) -> int:
    """As JavaScript's ``number | 0``."""
    return ((number + 2**31) & 0xFFFF_FFFF) - 2**31


def test_a_steady_period_is_nearly_nothing() -> None:
    steady = [1000.0 * i for i in range(3600)]
    assert len(packed(time_planes([steady] * 100))) < 4000


def test_times_beyond_what_fits_stay_at_the_end() -> None:
    planes = time_planes([[-5.0, 1e300]])
    first, second = numbers_of(planes, 4)
    assert first == 0
    assert second >> 1 == 2**31 - 1


@given(st.lists(st.floats()))
def test_values_come_back_as_exactly_as_the_steps_allow(values: list[float]) -> None:
    low, high, steps = quantised(values)
    assert len(steps) == len(values)
    known = [value for value in values if isfinite(value)]
    assert (low, high) == ((min(known), max(known)) if known else (0.0, 0.0))
    step = (high - low) / 0xFFFE
    for value, found in zip(values, steps, strict=True):
        if not isfinite(value):
            assert found == MISSING
        elif isfinite(step) and step > 1e-300:
            assert abs(low + found * step - value) <= step * 0.51 + abs(value) * 1e-9
        else:
            assert found == 0 or step > 0


def test_a_spike_and_a_gap_are_kept() -> None:
    values = [1.0] * 1000
    values[500], values[600] = 99.0, nan
    _, _, steps = quantised(values)
    assert steps[500] == 0xFFFE
    assert steps[600] == MISSING
    assert isnan(values[600])
