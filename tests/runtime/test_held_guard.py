"""A system whose guard does not answer for seconds, with real processes."""

from __future__ import annotations

import os
import signal
from typing import TYPE_CHECKING

import psutil

from play_launch.config.model import OnExit
from play_launch.supervisor.events import ContainerState, OutputLine, ProcessEventKind
from tests.support.tracing import stopped_by_a_tracer

from .fakes import system
from .test_native import container, node, pid_of, python, running_natively

if TYPE_CHECKING:
    from pathlib import Path

    from .running import Running

TICKS = "import time\nwhile True: print('tick', flush=True); time.sleep(0.02)"

REAL_TIME = True


def lines_of(sys: Running, name: str) -> int:
    return sum(isinstance(each, OutputLine) and each.process == name for each in sys.events)


async def until_more_lines(sys: Running, name: str) -> None:
    before = lines_of(sys, name)
    await sys.until(lambda: lines_of(sys, name) > before + 10)


async def until_member(sys: Running, name: str, state: ContainerState) -> None:
    await sys.operated.until(lambda: sys.operated.state_of(name) is state)


async def test_a_held_guard_holds_up_neither_the_others_nor_the_end(tmp_path: Path) -> None:
    ran = tmp_path / "ran"
    late = f"open({str(ran)!r}, 'a').write('x'); import time; time.sleep(600)"
    config = system(
        container("frozen", node("a", "Talker")),
        container("other", node("b", "Listener")),
        python("ticks", TICKS),
        python("late", late),
        python("later", late),
    )
    async with running_natively(config) as sys:
        await sys.until_loaded(2)
        await sys.until(ran.exists)
        for name in ("/late", "/later"):
            sys.operated.stop(name, "a trial")
            await until_member(sys, name, ContainerState.STOPPED)
        ran.write_text("")
        (guard,) = psutil.Process().children()
        with stopped_by_a_tracer(guard.pid):
            for name in ("/late", "/later"):
                sys.operated.start(name)
            await until_more_lines(sys, "/ticks")
            # The watchdog sees a container that does not answer.
            os.kill(pid_of(sys, "/frozen"), signal.SIGSTOP)
            await sys.until_state("/frozen", ContainerState.KILLING)
            sys.operated.stop("/later", "it is not needed")
            await until_member(sys, "/later", ContainerState.STOPPED)
            sys.stop.request(reason="Ctrl-C")
            await until_member(sys, "/late", ContainerState.STOPPED)
            await sys.until_state("/other", ContainerState.STOPPING)
    assert sys.outcome is not None
    assert not ran.read_text()


async def test_a_guard_that_is_lost_meanwhile_leaves_no_twin(tmp_path: Path) -> None:
    ran = tmp_path / "ran"
    late = f"open({str(ran)!r}, 'a').write('x'); import time; time.sleep(600)"
    config = system(
        python("ticks", TICKS, on_exit=OnExit.RESTART),
        python("late", late, on_exit=OnExit.RESTART),
    )
    async with running_natively(config) as sys:
        await sys.until(ran.exists)
        sys.operated.stop("/late", "a trial")
        await until_member(sys, "/late", ContainerState.STOPPED)
        ran.write_text("")
        (guard,) = psutil.Process().children()
        with stopped_by_a_tracer(guard.pid):
            sys.operated.start("/late")
            await until_more_lines(sys, "/ticks")
            guard.kill()
        await until_member(sys, "/late", ContainerState.RUNNING)
        await sys.until(lambda: ProcessEventKind.EXITED in sys.process_events("/ticks"))
        await sys.until(lambda: ran.read_text() != "")
        await until_more_lines(sys, "/ticks")
        assert ran.read_text() == "x"
