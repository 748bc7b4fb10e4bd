"""The one way to stop."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.process.child import Child, spawn
from play_launch.process.descendants import wait_all_ended
from play_launch.process.exit import Exit
from play_launch.process.identity import read_stat
from play_launch.process.stop import (
    StopLevel,
    StopPolicy,
    StopStep,
    plan,
    stop,
)
from tests.process.programs import (
    READY_THEN_SLEEP,
    Output,
    deaf_to,
    environment,
    exists,
    python,
)

if TYPE_CHECKING:
    from pathlib import Path

    from play_launch.process.guard import SessionGuard

pytestmark = pytest.mark.anyio

# Long enough that nothing but an answer ends a level in the tests about answers.
PATIENT = StopPolicy(ask=30, sigint=30, sigterm=30)
SECONDS = st.floats(0, 100)


@given(ask=SECONDS, sigint=SECONDS, sigterm=SECONDS, can_ask=st.booleans())
def test_levels_come_in_order_and_sigkill_last(
    ask: float, sigint: float, sigterm: float, can_ask: bool
) -> None:
    policy = StopPolicy(ask=ask, sigint=sigint, sigterm=sigterm)
    steps = plan(policy, can_ask=can_ask)
    levels = [step.level for step in steps]
    assert levels == sorted(set(levels))
    assert steps[-1] == StopStep(StopLevel.SIGKILL, policy.sigkill)
    assert (StopLevel.ASK in levels) == (can_ask and ask > 0)
    assert (StopLevel.SIGTERM in levels) == (sigterm > 0)
    assert all(step.limit > 0 for step in steps)


async def ready(argv: list[str], session: SessionGuard) -> tuple[Child, Output]:
    output = Output()
    child = await spawn(argv, env=environment(), guard=session, on_output=output)
    await output.wait_line("ready")
    return child, output


@pytest.mark.parametrize(
    ("deaf", "policy", "can_ask", "level", "signum"),
    [
        ((), PATIENT, True, StopLevel.ASK, signal.SIGUSR1),
        ((), PATIENT, False, StopLevel.SIGINT, signal.SIGINT),
        (("SIGINT",), StopPolicy(sigint=0.1, sigterm=30), False, StopLevel.SIGTERM, signal.SIGTERM),
        (
            ("SIGINT", "SIGTERM", "SIGHUP"),
            StopPolicy(sigint=0.1, sigterm=0.1, sigkill=30),
            False,
            StopLevel.SIGKILL,
            signal.SIGKILL,
        ),
    ],
)
async def test_a_stop_ends_with_the_first_level_that_has_an_effect(
    session: SessionGuard,
    deaf: tuple[str, ...],
    policy: StopPolicy,
    can_ask: bool,
    level: StopLevel,
    signum: signal.Signals,
) -> None:
    child, _ = await ready(deaf_to(*deaf) if deaf else python(READY_THEN_SLEEP), session)

    def ask() -> bool:
        return can_ask and child.send_signal(signal.SIGUSR1)  # stands for a message

    outcome = await stop(child, policy, ask=ask)
    assert (outcome.level, outcome.stragglers) == (level, 0)
    assert outcome.exit == Exit(signal=signum)
    assert not exists(child.pid)


async def test_a_frozen_process_can_still_go_in_order(session: SessionGuard) -> None:
    code = (
        "import signal, sys; signal.signal(signal.SIGTERM, lambda *_: sys.exit(5));"
        "signal.signal(signal.SIGINT, signal.SIG_IGN);" + READY_THEN_SLEEP
    )
    child, _ = await ready(python(code), session)
    child.send_signal(signal.SIGSTOP)
    outcome = await stop(child, StopPolicy(sigint=0.1, sigterm=30))
    assert (outcome.level, outcome.exit) == (StopLevel.SIGTERM, Exit(code=5))


async def test_hurry_goes_through_the_levels(session: SessionGuard) -> None:
    child, _ = await ready(deaf_to("SIGINT", "SIGTERM"), session)
    hurry = asyncio.Event()
    policy = StopPolicy(ask=600, sigint=600, sigterm=600, hurried=0.05)
    asked = asyncio.Event()

    def ask() -> bool:
        asked.set()
        return True

    stopping = asyncio.create_task(stop(child, policy, ask=ask, hurry=hurry))
    await asked.wait()
    hurry.set()
    async with asyncio.timeout(60):
        outcome = await stopping
    assert outcome.level is StopLevel.SIGKILL


# A parent that ends on SIGINT at once, and a child of it that takes its time or is deaf.
FAMILY = (
    "import subprocess, sys, time\n"
    "p = subprocess.Popen([sys.executable, '-I', '-S', '-c', sys.argv[1]],"
    " stdout=subprocess.PIPE{extra})\n"
    "p.stdout.readline(); print('ready', p.pid, flush=True); time.sleep(600)\n"
)


@pytest.mark.parametrize("extra", ["", ", process_group=0"], ids=["same group", "own group"])
async def test_what_a_child_leaves_gets_its_time_too(
    session: SessionGuard, extra: str, tmp_path: Path
) -> None:
    goodbye = tmp_path / "goodbye"
    slow = (
        "import signal, sys, time, pathlib\n"
        "def end(*_):\n"
        f"    time.sleep(0.3); pathlib.Path({str(goodbye)!r}).touch(); sys.exit()\n"
        "signal.signal(signal.SIGINT, end); print('up', flush=True); time.sleep(600)\n"
    )
    child, output = await ready([*python(FAMILY.format(extra=extra)), slow], session)
    grandchild = int(await output.wait_line("ready"))
    outcome = await stop(child, PATIENT)
    assert (outcome.level, outcome.stragglers) == (StopLevel.SIGINT, 0)
    assert goodbye.exists()
    assert not exists(grandchild) or not read_stat(grandchild).is_alive


async def test_deaf_leftovers_are_killed_and_counted(session: SessionGuard) -> None:
    deaf = deaf_to("SIGINT", "SIGTERM")[-1]
    child, output = await ready([*python(FAMILY.format(extra="")), deaf], session)
    grandchild = int(await output.wait_line("ready"))
    outcome = await stop(child, StopPolicy(sigint=0.3, sigterm=0.2))
    assert (outcome.level, outcome.stragglers) == (StopLevel.SIGINT, 1)
    assert not exists(grandchild) or not read_stat(grandchild).is_alive


async def test_a_cancelled_stop_still_ends_the_process(session: SessionGuard) -> None:
    deaf = deaf_to("SIGINT", "SIGTERM")[-1]
    child, output = await ready([*python(FAMILY.format(extra="")), deaf], session)
    grandchild = int(await output.wait_line("ready"))
    stopping = asyncio.create_task(stop(child, PATIENT))
    await child.wait()
    stopping.cancel()
    with pytest.raises(asyncio.CancelledError):
        await stopping
    async with asyncio.timeout(60):
        await child.gone()
    assert not exists(grandchild) or not read_stat(grandchild).is_alive


async def test_waiting_for_several_is_idle_after_the_end_of_the_first(
    session: SessionGuard, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pidfd stays readable, so it may not stay in the loop."""
    woken = 0

    class Counting(asyncio.Event):
        def set(self) -> None:
            nonlocal woken
            woken += 1
            super().set()

    first, second = [(await ready(python(READY_THEN_SLEEP), session))[0] for _ in range(2)]
    monkeypatch.setattr(asyncio, "Event", Counting)
    waiting = asyncio.create_task(wait_all_ended([first.identity, second.identity]))
    first.send_signal(signal.SIGKILL)
    await first.gone()
    for _ in range(1000):
        await asyncio.sleep(0)
    assert woken == 1
    second.send_signal(signal.SIGKILL)
    async with asyncio.timeout(60):
        await asyncio.gather(waiting, second.gone())
