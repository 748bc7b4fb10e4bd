from __future__ import annotations

from types import MappingProxyType

import pytest
from msgspec.structs import replace

from play_launch.config.dependency import Condition, Dependency, StartRule
from play_launch.config.model import OnExit
from play_launch.control.units import rows_of
from play_launch.process.exit import Exit
from play_launch.runtime.launcher import StartError
from play_launch.supervisor.events import ProcessEventKind

from .fakes import FakeLauncher, FakeProcess, process, system
from .jumping_loop import run
from .running import Running, running

STARTED, EXITED = ProcessEventKind.STARTED, ProcessEventKind.EXITED
RESTARTING, GAVE_UP = ProcessEventKind.RESTARTING, ProcessEventKind.GAVE_UP
STOPPED = ProcessEventKind.STOPPED
STOPPING = ProcessEventKind.STOPPING


def ending(exit_: Exit) -> FakeLauncher:
    return FakeLauncher(on_process=lambda started: started.end(exit_))


async def to_the_end(fakes: FakeLauncher, on_exit: OnExit, *, max_restarts: int = 3) -> Running:
    config = system(process("p", on_exit=on_exit, max_restarts=max_restarts))
    async with running(config, fakes) as sys:
        await sys.stop.requested.wait()
    return sys


@pytest.mark.parametrize(("exit_", "code"), [(Exit(), 0), (Exit(code=3), 1), (Exit(signal=11), 1)])
def test_it_runs_once(exit_: Exit, code: int) -> None:
    sys = run(to_the_end(ending(exit_), OnExit.IGNORE))
    assert sys.process_events("/p") == [STARTED, EXITED]
    assert sys.outcome is not None
    assert sys.outcome.exit_code == code


async def test_what_cannot_be_started_ends_the_system_as_well() -> None:
    fakes = FakeLauncher(failures={"/p": StartError("no file", permanent=True)})

    config = system(process("p", on_exit=OnExit.SHUTDOWN), process("q"))
    async with running(config, fakes) as sys:
        await sys.until_stopped()
    assert sys.outcome is not None
    assert (sys.stop.reason, sys.outcome.exit_code) == ("/p has ended", 1)


async def test_the_stop_of_a_process_does_not_end_the_system() -> None:
    config = system(process("p", on_exit=OnExit.SHUTDOWN), process("q"))
    async with running(config, FakeLauncher()) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/p"))
        sys.operated.restart("/p", "try again")
        await sys.until(lambda: sys.process_events("/p").count(STARTED) == 2)
        sys.operated.stop("/p", "not needed")
        await sys.until(lambda: sys.process_events("/p").count(EXITED) == 2)
        assert not sys.stop.requested.is_set()


def test_it_is_respawned_within_the_bounds() -> None:
    sys = run(to_the_end(ending(Exit()), OnExit.RESTART, max_restarts=2))
    again = [STARTED, EXITED, RESTARTING]
    assert sys.process_events("/p") == [*again, *again, STARTED, EXITED, GAVE_UP]
    assert sys.view.processes["/p"].restarts == 2
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 1


@pytest.mark.parametrize(
    ("exit_", "on_exit", "times"),
    [
        (Exit(), OnExit.IGNORE, 0),
        (Exit(code=3), OnExit.RESTART, 0),
        (Exit(signal=11), OnExit.IGNORE, 1),
        (Exit(signal=9), OnExit.RESTART, 3),
    ],
)
def test_what_it_left_in_shared_memory_is_removed_when_it_was_killed(
    exit_: Exit, on_exit: OnExit, times: int
) -> None:
    fakes = ending(exit_)
    run(to_the_end(fakes, on_exit, max_restarts=2))
    assert fakes.cleaned - 2 == times, "besides the beginning and the end of the run"


def test_a_program_that_is_not_there_is_not_respawned() -> None:
    sys = run(to_the_end(ending(Exit(code=127)), OnExit.RESTART))
    assert sys.process_events("/p") == [STARTED, EXITED, GAVE_UP]


@pytest.mark.parametrize(
    ("permanent", "on_exit", "tries"),
    [(True, OnExit.RESTART, 1), (False, OnExit.IGNORE, 1), (False, OnExit.RESTART, 4)],
)
def test_it_cannot_be_started(permanent: bool, on_exit: OnExit, tries: int) -> None:
    fakes = FakeLauncher(failures={"/p": StartError("no file", permanent=permanent)})
    sys = run(to_the_end(fakes, on_exit))
    assert sys.process_events("/p") == [RESTARTING] * (tries - 1) + [GAVE_UP]
    assert "no file" in sys.view.processes["/p"].message


async def test_it_is_stopped_with_a_signal() -> None:
    async with running(system(process("p", on_exit=OnExit.RESTART)), FakeLauncher()) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/p"))
    assert sys.process_events("/p") == [STARTED, STOPPING, EXITED]
    assert sys.launcher.processes["/p"][0].stopped_with == ["SIGINT"]
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0


async def test_a_stop_while_it_waits_for_its_respawn() -> None:
    async with running(system(process("p", on_exit=OnExit.RESTART)), ending(Exit(code=1))) as sys:
        await sys.until(lambda: RESTARTING in sys.process_events("/p"))
    assert sys.process_events("/p") == [STARTED, EXITED, RESTARTING, STOPPED]


async def test_what_does_not_die_is_told_and_does_not_hold_up_the_end(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def immortal(started: FakeProcess) -> None:
        started.deaf_to = {"SIGINT", "SIGKILL"}

    fakes = FakeLauncher(on_process=immortal)
    async with running(system(process("p")), fakes) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/p"))
        sys.stop.request()
        await sys.until_stopped()
        fakes.processes["/p"][0].end(Exit(signal=9))  # for the check that nothing is left
    assert "does not die" in caplog.text


async def test_what_is_stopped_between_two_starts_or_before_the_first_is_stopped() -> None:
    def row(sys: Running, name: str) -> str:
        (found,) = (each for each in rows_of(sys.view, [name], {}) if each.name == name)
        return found.state

    fakes = FakeLauncher()
    config = system(process("late"), process("restarts", on_exit=OnExit.RESTART), process("early"))
    waits = Dependency(condition=Condition.EXITED, unit="/early")
    rules = MappingProxyType({"/late": StartRule(dependencies=(waits,))})
    config = replace(config, start_rules=rules)
    async with running(config, fakes) as sys:
        await sys.until(lambda: ProcessEventKind.WAITING in sys.process_events("/late"))
        await sys.until(lambda: STARTED in sys.process_events("/restarts"))
        fakes.processes["/restarts"][0].end(Exit(code=3))
        await sys.until(lambda: RESTARTING in sys.process_events("/restarts"))
        assert (row(sys, "/late"), row(sys, "/restarts")) == ("waiting", "backoff")
        for name in ("/late", "/restarts"):
            sys.operated.stop(name, "not needed")
        await sys.until(lambda: row(sys, "/late") == "stopped")
        await sys.until(lambda: row(sys, "/restarts") == "stopped")
        sys.operated.start("/restarts")
        await sys.until(lambda: row(sys, "/restarts") == "running")


async def test_a_process_between_two_starts_is_missing() -> None:
    async with running(system(process("p", on_exit=OnExit.RESTART)), FakeLauncher()) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/p"))
        sys.launcher.processes["/p"][0].end(Exit(signal=11))
        await sys.until(lambda: RESTARTING in sys.process_events("/p"))
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 3
