from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.policies import OnCrash, RestartLimits
from play_launch.supervisor.restart import (
    FollowUp,
    GiveUp,
    Ignore,
    Restart,
    RestartHistory,
    Shutdown,
    StopContainer,
    follow_up,
)

JITTER = st.floats(0, 1, exclude_max=True)
BOUNDS = st.builds(
    RestartLimits,
    max_restarts=st.integers(0, 6),
    within=st.floats(0.1, 100),
    initial=st.floats(0.001, 2),
    maximum=st.floats(2, 60),
    first_at_once=st.just(True),
)


@pytest.mark.parametrize(
    ("policy", "expected"),
    [
        (OnCrash.IGNORE, Ignore()),
        (OnCrash.STOP_CONTAINER, StopContainer()),
        (OnCrash.SHUTDOWN, Shutdown()),
    ],
)
@given(bounds=BOUNDS, lived=st.floats(0, 1000), jitter=JITTER)
def test_only_a_reload_uses_up_restarts(
    policy: OnCrash, expected: FollowUp, bounds: RestartLimits, lived: float, jitter: float
) -> None:
    before = RestartHistory(recent=(1.0,), streak=2, total=3)
    assert follow_up(policy, before, bounds, now=5.0, lived=lived, jitter=jitter) == (
        before,
        expected,
    )


@given(BOUNDS, st.lists(st.tuples(st.floats(0, 1.5), JITTER), max_size=60))
def test_reloads_are_bounded_and_the_first_after_a_healthy_life_is_at_once(
    bounds: RestartLimits, lives: list[tuple[float, float]]
) -> None:
    reloads: list[float] = []
    history, now, unwell = RestartHistory(), 0.0, 0
    for part, jitter in lives:
        lived = part * bounds.within
        now += lived
        if lived >= bounds.within:
            unwell = 0
        history, verdict = follow_up(
            OnCrash.RELOAD, history, bounds, now=now, lived=lived, jitter=jitter
        )
        if isinstance(verdict, GiveUp):
            recent = [due for due in reloads if now - due < bounds.within]
            assert len(recent) == bounds.max_restarts
            break
        assert isinstance(verdict, Restart)
        if unwell == 0:
            assert verdict.delay == 0.0
        else:
            full = min(bounds.maximum, bounds.initial * 2.0 ** (unwell - 1))
            assert 0.5 * full <= verdict.delay <= full
        unwell += 1
        now += verdict.delay
        reloads.append(now)
        assert len([due for due in reloads if now - due < bounds.within]) <= bounds.max_restarts
    assert history.total == len(reloads)


def test_reloading_can_be_switched_off() -> None:
    never = RestartLimits(max_restarts=0, within=60.0, initial=0.1, maximum=1.0)
    _, verdict = follow_up(OnCrash.RELOAD, RestartHistory(), never, now=0.0, lived=5.0, jitter=0.0)
    assert isinstance(verdict, GiveUp)
