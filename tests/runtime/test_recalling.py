"""What is being stopped is started again by another operator, or replaced by a configuration."""

from __future__ import annotations

import asyncio
import os
from types import MappingProxyType
from typing import Any

import pytest
from msgspec.structs import replace

from play_launch.config.dependency import Condition, Dependency, StartRule
from play_launch.config.model import OnExit, ReplayConfig
from play_launch.control.actions import ActionLog, Actions
from play_launch.control.feed import Feed
from play_launch.control.messages import ActionRequest, ActionResult, Caller, Results
from play_launch.control.protocol import OperationError
from play_launch.process.exit import Exit
from play_launch.runtime.launcher import StartError
from play_launch.supervisor.events import ProcessEventKind
from play_launch.supervisor.expectations import Expectations
from play_launch.supervisor.plan import Result

from .fakes import FakeLauncher, process, system
from .running import Running, running

BEFORE = system(process("other"), process("p"))
CHANGED = system(process("other"), replace(process("p"), command=("p", "changed")))
WITHOUT = system(process("other"))
SLOW = 30.0


async def until_up(sys: Running) -> None:
    await sys.until(lambda: ProcessEventKind.STARTED in sys.process_events("/p"))


def slow(sys: Running) -> None:
    """Have what they leave take its time to end."""
    for each in sys.launcher.alive():
        each.lingers = SLOW


async def stop(sys: Running, *names: str, timeout: float = 60.0) -> Results:
    actions = Actions(
        sys.operated, sys.publisher, Feed(), ActionLog(sys.publisher), Expectations({})
    )
    request = ActionRequest(names=names, timeout=timeout)
    return await actions.act("stop", request, Caller(os.getpid(), 0))


async def test_a_stop_ends_when_its_unit_is_started_again() -> None:
    async with running(BEFORE, FakeLauncher()) as sys:
        await until_up(sys)
        slow(sys)
        stopping = asyncio.create_task(stop(sys, "/p"))
        await asyncio.sleep(1)
        sys.operated.start("/p")
        with pytest.raises(OperationError, match="/p: it was started again meanwhile"):
            await stopping
        await sys.until(lambda: len(sys.launcher.processes["/p"]) == 2)


async def test_a_stop_is_done_although_a_configuration_replaces_it_at_that_moment() -> None:
    async with running(BEFORE, FakeLauncher()) as sys:
        await until_up(sys)
        slow(sys)
        applying = asyncio.create_task(sys.operated.applying.apply(CHANGED))
        await asyncio.sleep(1)
        stopped = await stop(sys, "/p")
        assert stopped == Results((ActionResult("/p", None, done=True, reason=""),))
        assert (await applying).succeeded
        assert len(sys.launcher.processes["/p"]) == 1
        assert sys.operated.config.nodes == CHANGED.nodes
        sys.operated.start("/p")
        await sys.until(lambda: len(sys.launcher.processes["/p"]) == 2)


@pytest.mark.parametrize("target", [CHANGED, WITHOUT], ids=["changed", "taken out"])
async def test_a_start_does_not_keep_a_configuration_from_being_applied(target: Any) -> None:
    async with running(BEFORE, FakeLauncher()) as sys:
        await until_up(sys)
        slow(sys)
        applying = asyncio.create_task(sys.operated.applying.apply(target, limit=2 * SLOW))
        for _ in range(3):
            await asyncio.sleep(1)
            sys.operated.start("/p")
        assert (await applying).succeeded
        assert len(sys.launcher.processes["/p"]) == (2 if target is CHANGED else 1)
        assert not sys.operated.applying.plan(target).steps


async def test_a_stop_that_takes_too_long_names_only_what_still_runs() -> None:
    async with running(BEFORE, FakeLauncher()) as sys:
        await until_up(sys)
        sys.launcher.processes["/p"][0].lingers = SLOW
        with pytest.raises(OperationError, match=r"not done within 5 s: /p$") as late:
            await stop(sys, "/p", "/other", timeout=5)
        assert [each.name for each in late.value.details["results"]] == ["/other"]  # type: ignore[attr-defined]


async def test_a_configuration_that_is_refused_leaves_the_start_rules_as_they_were() -> None:
    class Unprepared(FakeLauncher):
        async def prepare(self, config: ReplayConfig) -> None:
            raise StartError("no control groups", permanent=True)

    before = system(process("p", on_exit=OnExit.RESTART), process("other"))
    waits = Dependency(condition=Condition.EXITED, unit="/other")
    rules = MappingProxyType({"/p": StartRule(dependencies=(waits,))})
    refused = replace(before, nodes=before.nodes[:1], start_rules=rules)
    async with running(before, Unprepared()) as sys:
        await sys.until(lambda: ProcessEventKind.STARTED in sys.process_events("/p"))
        applied = await sys.operated.applying.apply(refused)
        assert {each.result for each in applied.outcomes} == {Result.SKIPPED}
        sys.launcher.processes["/p"][0].end(Exit(signal=11))
        await sys.until(lambda: len(sys.launcher.processes["/p"]) == 2)
