from __future__ import annotations

import pytest

from play_launch.actors.ports import StartError
from play_launch.core.events import ProcessEventKind
from play_launch.process.exit import Exit

from .fakes import FakeLauncher, FakeProcess, process, system
from .jumping_loop import run
from .running import Running, running

STARTED, EXITED = ProcessEventKind.STARTED, ProcessEventKind.EXITED
RESTARTING, GAVE_UP = ProcessEventKind.RESTARTING, ProcessEventKind.GAVE_UP
STOPPING = ProcessEventKind.STOPPING


def ending(exit_: Exit) -> FakeLauncher:
    return FakeLauncher(on_process=lambda started: started.end(exit_))


async def to_the_end(fakes: FakeLauncher, *, respawn: bool, max_restarts: int = 3) -> Running:
    config = system(process("p", respawn=respawn, max_restarts=max_restarts))
    async with running(config, fakes) as sys:
        await sys.stop.requested.wait()
    return sys


@pytest.mark.parametrize(("exit_", "code"), [(Exit(), 0), (Exit(code=3), 1), (Exit(signal=11), 1)])
def test_it_runs_once(exit_: Exit, code: int) -> None:
    sys = run(to_the_end(ending(exit_), respawn=False))
    assert sys.process_events("/p") == [STARTED, EXITED]
    assert sys.outcome is not None
    assert sys.outcome.exit_code == code


def test_it_is_respawned_within_the_bounds() -> None:
    sys = run(to_the_end(ending(Exit()), respawn=True, max_restarts=2))
    again = [STARTED, EXITED, RESTARTING]
    assert sys.process_events("/p") == [*again, *again, STARTED, EXITED, GAVE_UP]
    assert sys.view.processes["/p"].restarts == 2
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 1


def test_a_program_that_is_not_there_is_not_respawned() -> None:
    sys = run(to_the_end(ending(Exit(code=127)), respawn=True))
    assert sys.process_events("/p") == [STARTED, EXITED, GAVE_UP]


@pytest.mark.parametrize(
    ("permanent", "respawn", "tries"), [(True, True, 1), (False, False, 1), (False, True, 4)]
)
def test_it_cannot_be_started(permanent: bool, respawn: bool, tries: int) -> None:
    fakes = FakeLauncher(failures={"/p": StartError("no file", permanent=permanent)})
    sys = run(to_the_end(fakes, respawn=respawn))
    assert sys.process_events("/p") == [RESTARTING] * (tries - 1) + [GAVE_UP]
    assert "no file" in sys.view.processes["/p"].message


def test_it_is_stopped_with_a_signal() -> None:
    async def main() -> Running:
        async with running(system(process("p", respawn=True)), FakeLauncher()) as sys:
            await sys.until(lambda: STARTED in sys.process_events("/p"))
        return sys

    sys = run(main())
    assert sys.process_events("/p") == [STARTED, STOPPING, EXITED]
    assert sys.launcher.processes["/p"][0].stopped_with == ["SIGINT"]
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0


def test_a_stop_while_it_waits_for_its_respawn() -> None:
    async def main() -> Running:
        async with running(system(process("p", respawn=True)), ending(Exit(code=1))) as sys:
            await sys.until(lambda: RESTARTING in sys.process_events("/p"))
        return sys

    assert run(main()).process_events("/p") == [STARTED, EXITED, RESTARTING]


def test_what_does_not_die_is_told_and_does_not_hold_up_the_end(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def immortal(started: FakeProcess) -> None:
        started.deaf_to = {"SIGINT", "SIGKILL"}

    async def main() -> None:
        fakes = FakeLauncher(on_process=immortal)
        async with running(system(process("p")), fakes) as sys:
            await sys.until(lambda: STARTED in sys.process_events("/p"))
            sys.stop.request()
            await sys.until_stopped()
            fakes.processes["/p"][0].end(Exit(signal=9))  # for the check that nothing is left

    run(main())
    assert "does not die" in caplog.text
