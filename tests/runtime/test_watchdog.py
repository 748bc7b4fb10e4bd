"""When a container that does not answer counts as frozen."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.container.messages import Outgoing, Query, Status
from play_launch.process.processor_wait import ProcessorWait
from play_launch.runtime import watch
from play_launch.runtime.watch import ContainerWatch, WatchLimits

LIMITS = WatchLimits(interval=1.0, timeout=3.0, lateness=0.5)


class Watched:
    """A container process under watch, at a time that only the test moves."""

    def __init__(self) -> None:
        self.now = 10.0
        self.queries: list[Outgoing] = []
        self.watch = ContainerWatch("/c", clock=lambda: self.now, limits=LIMITS)
        self.watch.begin(self.queries.append, 1)

    def next_check(self, late: float = 0.0) -> str:
        assert self.watch.due is not None
        self.now = self.watch.due + late
        return self.watch.on_time()

    def answer(self) -> None:
        query = self.queries[-1]
        assert isinstance(query, Query)
        self.watch.accept(Status(query_id=query.query_id))


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> list[ProcessorWait]:
    """What the threads that answer have waited, from a list of one."""
    theirs = [ProcessorWait(0.0, wants_one=False)]
    monkeypatch.setattr(
        watch, "waits", lambda pid: (ProcessorWait(0.0, wants_one=False), theirs[0])
    )
    return theirs


def test_a_query_every_interval_and_a_verdict_after_the_timeout() -> None:
    watched = Watched()
    for _ in range(3):
        began = watched.now
        assert watched.next_check() == ""
        assert watched.now == began + LIMITS.interval
        watched.answer()
    watched.answer()  # to no query, which is no news
    assert [watched.next_check(), watched.next_check()] == ["", ""]
    asked_at = watched.now - (LIMITS.timeout - LIMITS.last_look)
    assert watched.next_check() == "it is frozen: no answer for 3 s"
    assert watched.now == asked_at + LIMITS.timeout
    assert len(watched.queries) == 4
    assert watched.watch.due is None


def test_when_we_were_late_it_gets_its_time_again() -> None:
    watched = Watched()
    watched.next_check()
    watched.next_check(late=60.0)
    watched.next_check()
    watched.next_check(late=30.0)  # once more, in the last moment
    assert watched.next_check() == ""
    assert "frozen" in watched.next_check()


def test_a_process_without_a_processor_is_given_time_but_not_for_ever(
    waits: list[ProcessorWait],
) -> None:
    watched = Watched()
    waits[0] = ProcessorWait(0.0, wants_one=True)
    watched.next_check()
    asked_at = watched.now
    while not watched.next_check():
        pass
    assert watched.now - asked_at == LIMITS.timeout - LIMITS.last_look + LIMITS.longest
    # As soon as there are processors again, silence means something.
    watched = Watched()
    for _ in range(5):
        assert watched.next_check() == ""
    waits[0] = ProcessorWait(0.0, wants_one=False)
    assert "frozen" in watched.next_check()


def test_a_process_that_a_debugger_stops_gets_the_time_after_that(
    waits: list[ProcessorWait],
) -> None:
    watched = Watched()
    waits[0] = ProcessorWait(0.0, wants_one=False, is_traced=True)
    for _ in range(1000):
        assert watched.next_check() == ""
    waits[0] = ProcessorWait(0.0, wants_one=False)
    verdicts = [watched.next_check() for _ in range(3)]
    assert ["frozen" in each for each in verdicts] == [False, False, True]
    assert len(watched.queries) == 1


@given(
    st.lists(st.tuples(st.floats(0, 0.4), st.floats(0, 2.9)), max_size=50),
    st.lists(st.floats(0, 0.4), min_size=3, max_size=3),
)
def test_a_process_is_frozen_within_the_limits_and_not_while_it_answers(
    rounds: list[tuple[float, float]], lateness: list[float]
) -> None:
    watched = Watched()
    for late, takes in rounds:
        assert watched.next_check(late) == ""
        answered_at = watched.now + takes
        if answered_at >= (watched.watch.due or 0.0):
            assert watched.next_check() == ""
        watched.now = answered_at
        assert watched.watch.on_time() == ""
        watched.answer()
    last_answer = watched.now
    verdicts = [watched.next_check(late) for late in lateness]
    assert ["frozen" in each for each in verdicts] == [False, False, True]
    bound = LIMITS.interval + LIMITS.timeout + 3 * LIMITS.lateness
    assert watched.now - last_answer <= bound
