"""What the service manager hears of a system without processes, over a real socket."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from play_launch.config.model import ReplayConfig
from play_launch.deploy.notification import ServiceManager
from play_launch.deploy.sd_notify import ServiceReport, seen_of, status_text, summary_of
from play_launch.process.exit import Exit
from play_launch.runtime.launcher import StartError
from play_launch.runtime.system import System
from play_launch.supervisor.events import ContainerState, NodeState, ProcessEventKind
from play_launch.supervisor.inputs import Time
from play_launch.supervisor.view import SystemView
from tests.cli import scenes
from tests.runtime.fakes import FakeContainer, FakeLauncher, Held, container, process, system
from tests.runtime.jumping_loop import run
from tests.runtime.running import Running, running

from .listening import Listening, closing


class Slow(FakeContainer):
    """Its nodes are constructed on request."""

    def construct(self, held: Held) -> None:
        self.waiting = held

    def let_go(self) -> None:
        super().construct(self.waiting)


@asynccontextmanager
async def reported(
    config: ReplayConfig,
    launcher: FakeLauncher,
    listening: Listening,
    operable: asyncio.Future[None] | None = None,
) -> AsyncIterator[Running]:
    """Run a system and report on it, as the command does; it is operable where nothing is given."""
    async with running(config, launcher) as system:
        manager = ServiceManager(listening.address, watchdog=30)
        begun: asyncio.Future[System] = asyncio.get_running_loop().create_future()
        if operable is None:
            operable = asyncio.get_running_loop().create_future()
            operable.set_result(None)
        look = partial(seen_of, system.publisher, system.stop, begun, operable)
        report = ServiceReport(manager, system.stop, look)
        system.publisher.add_sink(report)
        for each in (begun, operable):
            each.add_done_callback(lambda _: report.changed.set())
        task = asyncio.create_task(report.run())
        try:
            while system.system is None:
                await asyncio.sleep(0)
            begun.set_result(system.system)
            yield system
            assert system.task is not None
            if not system.stop.requested.is_set():
                system.stop.request(reason="the test is over")
            await system.task
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


def slow(launcher: FakeLauncher) -> Slow:
    (found,) = launcher.containers["/slow"]
    assert isinstance(found, Slow)
    return found


def phases(lines: list[str]) -> list[str]:
    known = {"READY=1", "RELOADING=1", "STOPPING=1"}
    return [line for line in lines if line in known]


def test_ready_is_said_when_everything_is_up_or_failed_for_good(tmp_path: Path) -> None:
    launcher = FakeLauncher(
        makers={"/slow": [Slow]},
        failures={"/gone": StartError("no such program", permanent=True)},
    )
    config = system(container("slow", "n"), container("a", "m"), process("p"), process("gone"))

    async def main() -> None:
        async with reported(config, launcher, listening) as one:
            await one.until(lambda: one.view.loaded == 1 and "/gone" in one.gave_up())
            await asyncio.sleep(100)
            said = listening.hear_all()
            assert not phases(said)
            assert [each for each in said if each.startswith("STATUS=")][-1].startswith(
                "STATUS=starting, pending: /slow:/n; 1 of 2 nodes loaded"
            )
            # It hangs nowhere, so the manager is to wait.
            assert said.count("EXTEND_TIMEOUT_USEC=30000000") >= 9
            slow(launcher).let_go()
            await one.until_loaded(2)
            await asyncio.sleep(100)
            said = listening.hear_all()
            assert phases(said) == ["READY=1"]
            assert "EXTEND_TIMEOUT_USEC=30000000" not in said[said.index("READY=1") :]
            assert said.count("WATCHDOG=1") >= 9
        said = listening.hear_all()
        assert phases(said) == ["STOPPING=1"]
        assert any(each.startswith("STATUS=stopping: the test is over") for each in said)

    with closing(Listening.in_folder(tmp_path)) as listening:
        run(main())


def test_a_session_that_cannot_be_operated_yet_is_not_ready(tmp_path: Path) -> None:
    async def main() -> None:
        operable: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        async with reported(
            system(container("a", "m")), FakeLauncher(), listening, operable
        ) as one:
            await one.until_loaded(1)
            await asyncio.sleep(100)
            assert not phases(listening.hear_all())
            operable.set_result(None)
            await asyncio.sleep(1)
            assert phases(listening.hear_all()) == ["READY=1"]

    with closing(Listening.in_folder(tmp_path)) as listening:
        run(main())


SYSTEM = scenes.view(
    scenes.container("/a"),
    scenes.node("/a", 0, NodeState.LOADED),
    scenes.node("/a", 1, NodeState.LOADING),
    scenes.node("/a", 2, NodeState.LOAD_FAILED),
    scenes.container("/b", ContainerState.GAVE_UP),
    scenes.node("/b", 0, NodeState.PENDING),
    scenes.process("/p", ProcessEventKind.STARTED),
    scenes.process("/q", ProcessEventKind.EXITED, exit_code=3),
)


def test_status() -> None:
    assert status_text(["starting"], summary_of(SYSTEM)) == (
        "starting; 1 of 4 nodes loaded, 1 of 2 containers running, 1 of 2 processes running; "
        "failed: /b, /a/n2, /q"
    )
    assert status_text([], summary_of(SystemView())) == ""
    text = status_text(["a\nb", "x" * 500], summary_of(SYSTEM), "c\td")
    assert text.startswith("health problem: c d; a b; x")
    assert len(text) == 400


def test_what_is_stopped_while_it_starts_was_never_ready(tmp_path: Path) -> None:
    launcher = FakeLauncher(makers={"/slow": [Slow]})

    async def main() -> None:
        async with reported(system(container("slow", "n")), launcher, listening) as one:
            await one.until_state("/slow", ContainerState.RUNNING)
        assert phases(listening.hear_all()) == ["STOPPING=1"]

    with closing(Listening.in_folder(tmp_path)) as listening:
        run(main())


@pytest.mark.parametrize("is_operable", [True, False])
def test_what_is_over_at_once_was_ready(tmp_path: Path, is_operable: bool) -> None:
    launcher = FakeLauncher(on_process=lambda each: each.end(Exit()))

    async def main() -> None:
        never: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        operable = None if is_operable else never
        async with reported(system(process("p")), launcher, listening, operable) as one:
            await one.until_stopped()
        assert phases(listening.hear_all()) == ["READY=1", "STOPPING=1"]

    with closing(Listening.in_folder(tmp_path)) as listening:
        run(main())


def test_what_was_up_once_has_arrived(tmp_path: Path) -> None:
    launcher = FakeLauncher(makers={"/slow": [Slow]})

    async def main() -> None:
        config = system(container("slow", "n"), container("a"))
        async with reported(config, launcher, listening) as one:
            await one.until_state("/a", ContainerState.RUNNING)
            await asyncio.sleep(1)
            launcher.containers["/a"][0].process.end(Exit(signal=9))
            await one.until_state("/a", ContainerState.BACKOFF)
            assert one.operated.pending == ("/slow:/n",)
            # What a person does not want is not waited for either.
            slow(launcher).let_go()
            await one.until_loaded(1)
            assert not one.operated.pending

    with closing(Listening.in_folder(tmp_path)) as listening:
        run(main())


def test_a_timer_that_is_lost_is_not_hidden(tmp_path: Path) -> None:
    class Silent(FakeContainer):
        def start(self) -> None:
            pass

    async def main() -> None:
        launcher = FakeLauncher(makers={"/a": [Silent]})
        async with reported(system(container("a")), launcher, listening) as one:
            await one.until(lambda: bool(one.process_events("/a")))
            assert "WATCHDOG=1" in listening.hear_all()
            timer: Any = one.operated._timer
            timer.cancel()
            await asyncio.sleep(60)
            listening.hear_all()
            await asyncio.sleep(100)
            assert "WATCHDOG=1" not in listening.hear_all()
            problem = "STATUS=health problem: what was due "
            assert any(each.startswith(problem) for each in listening.said)
            one.operated.post(Time())
            await asyncio.sleep(11)
            assert "WATCHDOG=1" in listening.hear_all()

    with closing(Listening.in_folder(tmp_path)) as listening:
        run(main())
