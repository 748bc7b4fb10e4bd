from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from play_launch.core.watchdog import Verdict, Watch, WatchLimits, answered, begin, look

LIMITS = WatchLimits(interval=1.0, patience=3.0, lateness=0.5)


def test_a_question_every_interval_and_a_verdict_after_the_patience() -> None:
    watch = begin(10.0, LIMITS)
    assert look(watch, 10.9, LIMITS) == (watch, Verdict.WAIT)
    watch, verdict = look(watch, 11.0, LIMITS)
    assert verdict is Verdict.ASK
    assert answered(watch, 11.2, LIMITS) == Watch(due=12.2)
    assert look(watch, 13.9, LIMITS) == (watch, Verdict.WAIT)
    assert look(watch, 14.0, LIMITS) == (watch, Verdict.FROZEN)


def test_an_answer_to_no_question_is_no_news() -> None:
    watch = begin(10.0, LIMITS)
    assert answered(watch, 10.5, LIMITS) == watch


def test_when_we_were_late_it_gets_its_time_again() -> None:
    watch, _ = look(begin(0.0, LIMITS), 1.0, LIMITS)
    watch, verdict = look(watch, 60.0, LIMITS)
    assert verdict is Verdict.WAIT
    assert look(watch, 63.0, LIMITS)[1] is Verdict.FROZEN


@given(st.lists(st.tuples(st.floats(0, 0.4), st.floats(0, 2.9)), max_size=50))
def test_who_answers_in_time_is_never_frozen(rounds: list[tuple[float, float]]) -> None:
    now = 0.0
    watch = begin(now, LIMITS)
    for late, takes in rounds:
        now = watch.due + late
        watch, verdict = look(watch, now, LIMITS)
        assert verdict is Verdict.ASK
        now += takes
        assert look(watch, now, LIMITS)[1] is Verdict.WAIT
        watch = answered(watch, now, LIMITS)


@given(
    st.lists(st.floats(0, 2.9), max_size=20), st.lists(st.floats(0, 0.4), min_size=2, max_size=2)
)
def test_who_stops_answering_is_found_within_the_limits(
    answers: list[float], lateness: list[float]
) -> None:
    now = 0.0
    watch = begin(now, LIMITS)
    for takes in answers:
        now = watch.due
        watch, _ = look(watch, now, LIMITS)
        now += takes
        watch = answered(watch, now, LIMITS)
    last_answer, verdicts = now, []
    for late in lateness:
        now = watch.due + late
        watch, verdict = look(watch, now, LIMITS)
        verdicts.append(verdict)
    assert verdicts == [Verdict.ASK, Verdict.FROZEN]
    bound = LIMITS.interval + LIMITS.patience + 2 * LIMITS.lateness
    assert now - last_answer <= bound
