"""Lengths of time."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.values import (
    LONGEST_DURATION,
    parse_duration,
    parse_positive_duration,
)

UNITS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}


@pytest.mark.parametrize(
    ("written", "seconds"),
    [
        ("10 s", 10.0),
        ("10s", 10.0),
        ("250 ms", 0.25),
        ("2 min", 120.0),
        ("1.5 s", 1.5),
        (".5 h", 1800.0),
        ("5. s", 5.0),
        ("40 us", 4e-5),
        ("7", 7.0),
        (7, 7.0),
        (0.25, 0.25),
        (" 3 s ", 3.0),
    ],
)
def test_forms(written: object, seconds: float) -> None:
    assert parse_duration(written) == pytest.approx(seconds)


@pytest.mark.parametrize(
    ("written", "fragment"),
    [
        ("", "expected a duration"),
        ("s", "expected a duration"),
        ("1 s 2", "expected a duration"),
        ("1e3 s", "expected a duration"),
        ("5 seconds", "units: us, ms, s, min, h"),
        ("1:30", "expected a duration"),
        ("-1 s", "negative"),
        (-0.0, "negative"),
        ("9000 h", "longer than 8760 h"),
        (math.nan, "expected a duration"),
        (math.inf, "longer than"),
        (10**400, "longer than"),
        (True, "expected a duration"),
        (None, "expected a duration"),
        ([1], "expected a duration"),
    ],
)
def test_refused(written: object, fragment: str) -> None:
    with pytest.raises(ValueError, match=r"duration|unit|longer|mean") as caught:
        parse_duration(written)
    assert fragment in str(caught.value)


def test_zero_is_no_positive_duration() -> None:
    assert parse_duration("0 s") == 0.0
    with pytest.raises(ValueError, match="longer than 0 s"):
        parse_positive_duration("0 ms")


@given(st.integers(0, 8760), st.sampled_from(sorted(UNITS)), st.sampled_from(["", " ", "  "]))
def test_number_and_unit(number: int, unit: str, space: str) -> None:
    assert parse_duration(f"{number}{space}{unit}") == pytest.approx(number * UNITS[unit])


@given(st.floats(0, LONGEST_DURATION).map(abs))
def test_plain_numbers_are_seconds(seconds: float) -> None:
    assert parse_duration(seconds) == seconds


@given(st.text() | st.integers() | st.floats() | st.none() | st.booleans())
def test_anything_else_is_refused_politely(value: object) -> None:
    try:
        seconds = parse_duration(value)
    except ValueError:
        return
    assert 0.0 <= seconds <= LONGEST_DURATION
