"""Answers of the guard are awaited: what is given up never runs, and nothing runs twice."""

from __future__ import annotations

import asyncio
import errno
import os
import signal
from pathlib import Path

import psutil
import pytest

from play_launch.process.child import Child, spawn
from play_launch.process.exit import Exit
from play_launch.process.guard import SessionGuard, SpawnError
from play_launch.process.stop import StopPolicy, stop
from tests.process.programs import Output, environment, python, shell
from tests.support.tracing import stopped_by_a_tracer
from tests.support.waiting import until

pytestmark = pytest.mark.anyio

MANY = 40
"""More than are sent before the first one is answered."""


def children_of(session: SessionGuard) -> list[psutil.Process]:
    return psutil.Process(session.pid).children()


async def passes(steps: int = 20) -> None:
    """Let the event loop go round."""
    for _ in range(steps):
        await asyncio.sleep(0)


def starting(session: SessionGuard, script: str) -> asyncio.Task[Child]:
    return asyncio.create_task(spawn(shell(script), env=environment(), guard=session))


async def test_the_loop_goes_on_while_a_guard_is_held(
    session: SessionGuard, tmp_path: Path
) -> None:
    ticking = "import time\nwhile True: print('tick', flush=True); time.sleep(0.005)"
    output = Output()
    child = await spawn(python(ticking), env=environment(), guard=session, on_output=output)
    short = await spawn(shell("exit 3"), env=environment(), guard=session)
    log = tmp_path / "log"
    with stopped_by_a_tracer(session.pid):
        starts = [starting(session, f"echo {number} >> {log}") for number in range(MANY)]
        await passes()
        before = len(output.texts())
        while len(output.texts()) < before + 20:
            await asyncio.sleep(0.001)
        assert short.is_running, "only the guard can tell"
        assert not any(each.done() for each in starts)
        assert not log.exists()
    assert await short.gone() == Exit(code=3)
    for each in await asyncio.gather(*starts):
        assert await each.gone() == Exit()
    assert sorted(map(int, log.read_text().split())) == list(range(MANY))
    await stop(child, StopPolicy())
    assert session.is_alive


@pytest.mark.parametrize("before", [0, MANY], ids=["that was sent", "in the queue"])
async def test_a_start_that_is_given_up_never_runs(
    session: SessionGuard, tmp_path: Path, before: int
) -> None:
    ran = tmp_path / "ran"
    with stopped_by_a_tracer(session.pid):
        others = [starting(session, "exit 3") for _ in range(before)]
        start = starting(session, f"touch {ran}; exec sleep 600")
        await passes()
        start.cancel()
        with pytest.raises(asyncio.CancelledError):
            await start
    for each in await asyncio.gather(*others):
        assert await each.gone() == Exit(code=3)
    # Not as a zombie either.
    await asyncio.to_thread(until, lambda: not children_of(session), "the end of what was forked")
    assert not ran.exists()


async def test_a_start_that_is_given_up_with_its_answer_never_runs(
    session: SessionGuard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = tmp_path / "ran"
    read = SessionGuard._read

    def read_and_cancel(self: SessionGuard) -> None:
        read(self)
        start.cancel()

    monkeypatch.setattr(SessionGuard, "_read", read_and_cancel)
    start = starting(session, f"touch {ran}; exec sleep 600")
    with pytest.raises(asyncio.CancelledError):
        await start
    await asyncio.to_thread(until, lambda: not children_of(session), "the end of what was forked")
    assert not ran.exists()


async def test_a_guard_that_is_killed_meanwhile_starts_nothing(guard: Path, tmp_path: Path) -> None:
    session = SessionGuard.start(guard)
    child = await spawn(shell("exec sleep 600"), env=environment(), guard=session)
    ran = tmp_path / "ran"
    with stopped_by_a_tracer(session.pid):
        starts = [starting(session, f"touch {ran}") for _ in range(MANY)]
        await passes()
        os.kill(session.pid, signal.SIGKILL)
    for each in await asyncio.gather(*starts, return_exceptions=True):
        assert isinstance(each, SpawnError)
        assert each.errno == errno.ECONNRESET
    assert (await child.gone()).is_lost
    assert not session.is_alive
    assert not ran.exists()
    await session.end()


async def test_further_requests_do_not_put_the_limit_off(guard: Path) -> None:
    session = SessionGuard.start(guard, answer_limit=0.3)
    with stopped_by_a_tracer(session.pid):
        starts: list[asyncio.Task[Child]] = []
        while session.is_alive:
            starts.append(starting(session, "exit 3"))
            await asyncio.wait(starts, timeout=0.05)
        for each in await asyncio.gather(*starts, return_exceptions=True):
            assert isinstance(each, SpawnError)
    await session.end()


async def test_ending_it_ends_what_is_awaited(guard: Path, tmp_path: Path) -> None:
    session = SessionGuard.start(guard)
    ran = tmp_path / "ran"
    with stopped_by_a_tracer(session.pid):
        start = starting(session, f"touch {ran}; exec sleep 600")
        await passes()
        ending = asyncio.create_task(session.end())
        with pytest.raises(SpawnError):
            await start
    await ending
    assert not ran.exists()
