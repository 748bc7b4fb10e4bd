"""When a container that does not answer counts as frozen."""

from __future__ import annotations

import asyncio

import anyio
import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.container.messages import Outgoing, Query, Status
from play_launch.process.processor_wait import ProcessorWait
from play_launch.runtime import watchdog
from play_launch.runtime.watchdog import (
    INTERVAL,
    LAST_PART,
    LATENESS,
    LONGEST,
    TIMEOUT,
    ContainerWatch,
)

from .jumping_loop import JumpingLoop, run


class Watched:
    """A container process under watch, which answers each query after so many seconds."""

    def __init__(self, *answers: float) -> None:
        self.answers = [*answers]
        self.asked_at: list[float] = []
        self._watch = ContainerWatch("/c", self._send, 1)

    def _send(self, query: Outgoing) -> None:
        assert isinstance(query, Query)
        self.asked_at.append(anyio.current_time())
        answer = Status(query_id=query.query_id)
        if self.answers:
            loop = asyncio.get_running_loop()
            loop.call_later(self.answers.pop(0), self._watch.accept, answer)

    async def until_frozen(self) -> float:
        """Return the seconds from its last query to the verdict."""
        verdict = await self._watch.run()
        assert verdict == "it is frozen: no answer for 3 s"
        return anyio.current_time() - self.asked_at[-1]


def stop_us(seconds: float) -> None:
    """Let the time go on without the loop."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, JumpingLoop)
    loop.jump(seconds)


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> list[ProcessorWait]:
    """What the threads that answer have waited, from a list of one."""
    theirs = [ProcessorWait(0.0, wants_one=False)]
    ours = ProcessorWait(0.0, wants_one=False)
    monkeypatch.setattr(watchdog, "waits", lambda pid: (ours, theirs[0]))
    return theirs


async def test_a_query_every_interval_and_a_verdict_after_the_timeout() -> None:
    watched = Watched(0.0, 0.0, 0.0)
    began = anyio.current_time()
    assert await watched.until_frozen() == TIMEOUT
    assert watched.asked_at == [began + count * INTERVAL for count in range(1, 5)]


async def test_when_we_were_late_it_gets_its_time_again() -> None:
    watched = Watched()
    loop = asyncio.get_running_loop()
    for at in (INTERVAL + 1.0, INTERVAL + 1.0 + 60.0 + TIMEOUT - LAST_PART + 0.1):
        loop.call_later(at, stop_us, 60.0)
    assert await watched.until_frozen() > 2 * 60.0 + TIMEOUT


async def test_a_process_without_a_processor_is_given_time_but_not_for_ever(
    waits: list[ProcessorWait],
) -> None:
    waits[0] = ProcessorWait(0.0, wants_one=True)
    assert await Watched().until_frozen() == TIMEOUT - LAST_PART + LONGEST
    # As soon as there are processors again, silence means something.
    idle = ProcessorWait(0.0, wants_one=False)
    asyncio.get_running_loop().call_later(10.0, waits.__setitem__, 0, idle)
    assert await Watched().until_frozen() < 10.0


async def test_a_process_that_a_debugger_stops_gets_the_time_after_that(
    waits: list[ProcessorWait],
) -> None:
    waits[0] = ProcessorWait(0.0, wants_one=False, is_traced=True)
    idle = ProcessorWait(0.0, wants_one=False)
    asyncio.get_running_loop().call_later(3600.0, waits.__setitem__, 0, idle)
    watched = Watched()
    assert 3600.0 < await watched.until_frozen() + INTERVAL < 3600.0 + 3 * TIMEOUT
    assert len(watched.asked_at) == 1


@given(st.lists(st.tuples(st.floats(0, 0.4), st.floats(0, 2.9)), max_size=50))
def test_a_process_is_not_frozen_while_it_answers_and_soon_after_that(
    rounds: list[tuple[float, float]],
) -> None:
    async def main() -> None:
        watched = Watched(*(takes for _, takes in rounds))
        loop = asyncio.get_running_loop()
        at = 0.0
        for late, takes in rounds:
            at += INTERVAL
            loop.call_later(at, stop_us, late)
            at += late + takes
        assert await watched.until_frozen() <= TIMEOUT + 3 * LATENESS
        assert not watched.answers

    run(main())
