from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.model import RestartLimits
from play_launch.supervisor.outcome import GiveUp, Restart, RestartHistory, decide

JITTER = st.floats(0, 1, exclude_max=True)
BOUNDS = st.builds(
    RestartLimits,
    max_restarts=st.integers(0, 6),
    within=st.floats(0.1, 100),
    initial=st.floats(0.001, 2),
    maximum=st.floats(2, 60),
    first_at_once=st.just(True),
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
        history, verdict = decide(history, bounds, now=now, lived=lived, jitter=jitter)
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
    _, verdict = decide(RestartHistory(), never, now=0.0, lived=5.0, jitter=0.0)
    assert isinstance(verdict, GiveUp)
