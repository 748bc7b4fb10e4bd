"""When the first answer may be given."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.graph_daemon.server.pulse import LONGEST_WARM_UP, QUIET, WINDOW, Pulse

moments = st.lists(st.floats(0, 20), max_size=40).map(sorted)


def test_it_is_warm_after_a_pause_if_nobody_is_missing() -> None:
    pulse = Pulse(0.0)
    pulse.change(0.25)
    assert not pulse.is_warm(0.25 + QUIET / 2, complete=True)
    assert pulse.is_warm(0.25 + QUIET, complete=True)
    assert not pulse.is_warm(0.25 + QUIET, complete=False)


def test_it_is_warm_at_the_latest_after_a_while() -> None:
    pulse = Pulse(10.0)
    assert not pulse.is_warm(10.0 + LONGEST_WARM_UP - 0.01, complete=False)
    assert pulse.is_warm(10.0 + LONGEST_WARM_UP, complete=False)


@given(moments, st.floats(0, 20))
def test_who_looks_when_due_sees_it_get_warm_in_time(changes: list[float], start: float) -> None:
    """With changes at any time, looking again as told ends at the deadline, in few looks."""
    pulse = Pulse(start)
    now, looks = start, 0
    pending = [start + change for change in changes]
    while not pulse.is_warm(now, complete=False):
        following = pulse.look_again_at(now)
        assert following > now
        now = following
        looks += 1
        while pending and pending[0] <= now:
            pulse.change(pending.pop(0))
    assert now <= pulse.deadline + 0.2
    assert looks <= 60


@given(moments)
def test_the_rate_is_that_of_the_last_seconds(changes: list[float]) -> None:
    pulse = Pulse(0.0)
    for change in changes:
        pulse.change(change)
    now = 20.0
    recent = [change for change in changes if change > now - WINDOW]
    assert pulse.rate(now) == pytest.approx(len(recent) / WINDOW)
    assert pulse.quiet_for(now) == pytest.approx(now - (changes[-1] if changes else 0.0))


def test_a_storm_is_remembered_for_a_while_only() -> None:
    pulse = Pulse(0.0)
    for number in range(10_000):
        pulse.change(number * 0.05)
    assert pulse.rate(10_000 * 0.05) == pytest.approx(20, rel=0.1)
    assert len(pulse._changes) <= WINDOW / 0.05 + 1
