from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from play_launch.runtime.watch import Verdict, Watch, WatchLimits, answered, begin, look

LIMITS = WatchLimits(interval=1.0, timeout=3.0, lateness=0.5)


def test_a_question_every_interval_and_a_verdict_after_the_timeout() -> None:
    watch = begin(10.0, LIMITS)
    assert look(watch, 10.9, LIMITS) == (watch, Verdict.WAIT)
    watch, verdict = look(watch, 11.0, LIMITS)
    assert verdict is Verdict.ASK
    assert answered(watch, 11.2, LIMITS) == Watch(due=12.2)
    assert look(watch, 13.4, LIMITS) == (watch, Verdict.WAIT)
    watch, verdict = look(watch, 13.5, LIMITS)
    assert verdict is Verdict.SUSPECT
    assert answered(watch, 13.7, LIMITS) == Watch(due=14.7)
    assert look(watch, 13.9, LIMITS) == (watch, Verdict.WAIT)
    assert look(watch, 14.0, LIMITS) == (watch, Verdict.FROZEN)


def test_an_answer_to_no_question_is_no_news() -> None:
    watch = begin(10.0, LIMITS)
    assert answered(watch, 10.5, LIMITS) == watch


def test_when_we_were_late_it_gets_its_time_again() -> None:
    watch, _ = look(begin(0.0, LIMITS), 1.0, LIMITS)
    watch, verdict = look(watch, 60.0, LIMITS)
    assert verdict is Verdict.WAIT
    watch, verdict = look(watch, 62.5, LIMITS)
    assert verdict is Verdict.SUSPECT
    # Late once more, in the last moment.
    again, verdict = look(watch, 90.0, LIMITS)
    assert verdict is Verdict.WAIT
    assert again.suspected_at is None
    assert look(watch, 63.0, LIMITS)[1] is Verdict.FROZEN


def test_who_gets_no_processor_is_given_time_but_not_for_ever() -> None:
    watch, _ = look(begin(0.0, LIMITS), 1.0, LIMITS)
    verdicts = []
    while Verdict.FROZEN not in verdicts:
        watch, verdict = look(watch, watch.due, LIMITS, starved=True)
        verdicts.append(verdict)
    assert verdicts == [Verdict.SUSPECT] * (len(verdicts) - 1) + [Verdict.FROZEN]
    assert watch.due - 1.0 == LIMITS.timeout - LIMITS.last_look + LIMITS.longest
    # As soon as there are processors again, silence means something.
    watch, _ = look(begin(0.0, LIMITS), 1.0, LIMITS)
    for starved in (True, True, True):
        watch, verdict = look(watch, watch.due, LIMITS, starved=starved)
        assert verdict is Verdict.SUSPECT
    assert look(watch, watch.due, LIMITS)[1] is Verdict.FROZEN


def test_who_is_stopped_by_a_debugger_gets_the_time_after_that() -> None:
    watch, _ = look(begin(0.0, LIMITS), 1.0, LIMITS)
    for _ in range(1000):
        watch, verdict = look(watch, watch.due, LIMITS)
        assert verdict is Verdict.SUSPECT
        watch, verdict = look(watch, watch.due, LIMITS, stopped=True)
        assert verdict is Verdict.WAIT
    goes_on = watch.due - (LIMITS.timeout - LIMITS.last_look)
    assert goes_on > 1000 * LIMITS.timeout
    watch, verdict = look(watch, watch.due, LIMITS)
    assert verdict is Verdict.SUSPECT
    assert look(watch, watch.due, LIMITS)[1] is Verdict.FROZEN
    assert watch.due == goes_on + LIMITS.timeout


@given(st.lists(st.tuples(st.floats(0, 0.4), st.floats(0, 2.9)), max_size=50))
def test_who_answers_in_time_is_never_frozen(rounds: list[tuple[float, float]]) -> None:
    now = 0.0
    watch = begin(now, LIMITS)
    for late, takes in rounds:
        now = watch.due + late
        watch, verdict = look(watch, now, LIMITS)
        assert verdict is Verdict.ASK
        now += takes
        if now >= watch.due:
            watch, verdict = look(watch, watch.due, LIMITS)
            assert verdict is Verdict.SUSPECT
        assert look(watch, now, LIMITS)[1] is Verdict.WAIT
        watch = answered(watch, now, LIMITS)


@given(
    st.lists(st.floats(0, 2.9), max_size=20), st.lists(st.floats(0, 0.4), min_size=3, max_size=3)
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
    assert verdicts == [Verdict.ASK, Verdict.SUSPECT, Verdict.FROZEN]
    bound = LIMITS.interval + LIMITS.timeout + 3 * LIMITS.lateness
    assert now - last_answer <= bound
