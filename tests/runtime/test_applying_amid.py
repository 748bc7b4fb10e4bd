"""Another configuration for a system of which something waits, crashes, hangs or was stopped."""

from __future__ import annotations

import asyncio
from types import MappingProxyType
from typing import NoReturn

import pytest
from msgspec.structs import replace

from play_launch.config.dependency import Condition
from play_launch.config.model import (
    Autostart,
    ComposableNodeConfig,
    ManagedConfig,
    OnExit,
    ParameterConfig,
    ParameterType,
    ParameterValue,
)
from play_launch.config.node_key import NodeKey
from play_launch.container.messages import Load
from play_launch.process.exit import Exit
from play_launch.runtime.launcher import StartError
from play_launch.supervisor import change
from play_launch.supervisor.events import ContainerState, NodeState, ProcessEventKind

from .fake_parameters import FakeParameters
from .fakes import (
    FakeContainer,
    FakeLauncher,
    FakeProcess,
    container,
    node,
    process,
    system,
)
from .running import running
from .test_order import on, rules

STARTED = ProcessEventKind.STARTED


async def test_a_rule_that_is_gone_while_no_slot_is_free_does_not_block_the_loop() -> None:
    class Silent(FakeContainer):
        def start(self) -> None:
            pass

    before = system(container("s"), container("c", "a"))
    config = rules(before, c=on(Condition.FILE, subject="/nonexistent/file", timeout=7))
    launcher = FakeLauncher({"/s": [Silent]})
    async with running(config, launcher, starts=1) as sys:
        await asyncio.sleep(1)
        await sys.operated.applying.apply(before)
        await asyncio.sleep(20)
        assert "/c" not in launcher.containers
        await sys.until_loaded(1)


async def test_a_crash_loop_is_not_started_once_more_as_it_was_configured_before() -> None:
    def dies(each: FakeProcess) -> None:
        if each.argv == ("bad",):
            each.end(Exit(code=1))

    launcher = FakeLauncher(on_process=dies)
    bad = replace(process("p", on_exit=OnExit.RESTART, max_restarts=100), command=("bad",))
    good = replace(bad, command=("good",))
    async with running(system(bad), launcher) as sys:
        await asyncio.sleep(20)
        started = len(launcher.processes["/p"])
        assert sys.view.processes["/p"].kind is ProcessEventKind.RESTARTING
        assert (await sys.operated.applying.apply(system(good))).succeeded
        assert [each.argv for each in launcher.processes["/p"][started:]] == [("good",)]


async def test_one_that_waits_is_replaced_without_having_been_started() -> None:
    launcher = FakeLauncher()
    old = replace(process("p"), command=("old",))
    config = rules(system(old, process("q")), p=on(Condition.FILE, subject="/nonexistent/file"))
    target = replace(config, nodes=(replace(old, command=("new",)), process("q")))
    async with running(config, launcher) as sys:
        await asyncio.sleep(1)
        await sys.operated.applying.apply(target, limit=1)
        sys.operated.start("/p")
        await sys.until(lambda: STARTED in sys.process_events("/p"))
        await asyncio.sleep(5)
        assert [each.argv for each in launcher.processes["/p"]] == [("new",)]


async def test_a_container_becomes_a_process_of_its_name() -> None:
    launcher = FakeLauncher()
    async with running(system(container("x", "a"), process("q")), launcher) as sys:
        await sys.until_loaded(1)
        applied = await sys.operated.applying.apply(system(process("x"), process("q")))
        assert applied.succeeded, applied
        assert list(sys.view.containers) == []
        assert sys.view.processes["/x"].pid
        applied = await sys.operated.applying.apply(system(container("x", "a"), process("q")))
        assert applied.succeeded, applied
        assert list(sys.view.processes) == ["/q"]
        assert sys.view.loaded == 1


async def test_an_unloaded_node_returns_with_its_replaced_container() -> None:
    launcher = FakeLauncher()
    async with running(system(container("x", "a", "b")), launcher) as sys:
        await sys.until_loaded(2)
        sys.operated.stop(NodeKey("/x", "/a"))
        await sys.until_loaded(1)
        target = replace(container("x", "a", "b"), environment={"A": "b"})
        applied = await sys.operated.applying.apply(system(target))
        assert applied.succeeded, applied
        assert sys.view.loaded == 2


async def test_one_that_was_started_once_waits_for_nothing_when_it_is_replaced() -> None:
    launcher = FakeLauncher()
    before = rules(system(process("p"), process("q")), p=on(Condition.STARTED, "/q"))
    async with running(before, launcher) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/p"))
        sys.operated.stop("/q", "x")
        await asyncio.sleep(5)
        new = replace(process("p"), command=("new",))
        deaf = replace(process("q"), on_exit=OnExit.RESTART)
        target = replace(before, nodes=(new, deaf))
        await sys.operated.applying.apply(target, limit=1)
        assert [each.argv for each in launcher.processes["/p"]] == [("p",), ("new",)]


@pytest.mark.parametrize("down", [True, False])
async def test_a_node_that_is_not_managed_any_more_has_arrived(down: bool) -> None:
    launcher = FakeLauncher()
    plain = system(container("c", "a"), process("p"))
    key = "/c:/a"
    managed = ManagedConfig(name="/a", autostart=Autostart.ACTIVATE)
    before = replace(plain, managed=MappingProxyType({key: managed}))
    async with running(before, launcher) as sys:
        await sys.until_loaded(1)
        assert sys.operated.pending == (key,)
        if down:
            launcher.containers["/c"][0].crash()
            await sys.until_state("/c", ContainerState.BACKOFF)
        await sys.operated.applying.apply(plain)
        await sys.until_loaded(1)
        assert not sys.operated.pending


@pytest.mark.parametrize("where", ["_settle", "_result"])
async def test_a_bug_in_the_rules_of_a_change_ends_the_change_only(
    where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def raises(*args: object) -> NoReturn:
        raise LookupError("a bug")

    launcher = FakeLauncher()
    stays = process("p"), process("r", on_exit=OnExit.RESTART)
    async with running(system(*stays), launcher) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/r"))
        monkeypatch.setattr(change, where, raises)
        applying = asyncio.create_task(
            sys.operated.applying.apply(system(*stays, process("q")), limit=10)
        )
        await asyncio.sleep(20)
        launcher.processes["/r"][0].end(Exit(code=1))
        await asyncio.sleep(20)
        assert len(launcher.processes["/r"]) == 2
        applied = await applying
        assert not applied.succeeded


async def test_one_that_was_stopped_by_hand_is_gone_when_its_removal_is_done() -> None:
    launcher = FakeLauncher()
    async with running(system(process("p"), process("q")), launcher) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/p"))
        launcher.processes["/p"][0].deaf_to.add("SIGINT")
        sys.operated.stop("/p", "x")
        applied = await sys.operated.applying.apply(system(process("q")))
        assert applied.succeeded
        assert "/p" not in sys.view.processes


async def test_one_that_is_added_and_can_never_start_is_known_to_have_failed() -> None:
    launcher = FakeLauncher(failures={"/bad": StartError("no file", permanent=True)})
    before = system(process("bad"), process("q"))
    after = system(process("bad"), process("q"), process("late"))
    target = rules(after, late=on(Condition.STARTED, "/bad"))
    async with running(before, launcher) as sys:
        await sys.until(lambda: "/bad" in sys.gave_up())
        await sys.operated.applying.apply(target, limit=5)
        assert "/late" in sys.gave_up()
        assert sys.view.processes["/late"].kind is ProcessEventKind.GAVE_UP


async def test_parameters_that_could_not_be_set_in_time_are_those_of_the_next_load() -> None:
    class Hangs(FakeParameters):
        async def set(self, *args: object) -> str:
            await asyncio.sleep(1000)
            return ""

    def rate(value: int) -> ComposableNodeConfig:
        given = ParameterConfig("rate", ParameterValue(ParameterType.INTEGER, value))
        return replace(node("a"), parameters=(given,))

    launcher = FakeLauncher()
    before = system(container("c", rate(1)))
    async with running(before, launcher, parameters=Hangs()) as sys:
        await sys.until_loaded(1)
        target = system(container("c", rate(2)))
        await sys.operated.applying.apply(target, limit=1)
        assert not sys.operated.applying.plan(target).steps
        launcher.containers["/c"][0].crash_node("a")
        await sys.until(lambda: len(sys.node_events("/a", NodeState.LOADED)) == 2)
        (box,) = launcher.containers["/c"]
        loads = [each for each in box.link.sent if isinstance(each, Load)]
        assert [each.parameters[0].value.value for each in loads] == [1, 2]


async def test_a_node_that_is_taken_out_is_reported_as_unloaded_before() -> None:
    async with running(system(container("c", "a", "b")), FakeLauncher()) as sys:
        await sys.until_loaded(2)
        await sys.operated.applying.apply(system(container("c", "a")))
        assert sys.node_states("/b")[-2:] == [NodeState.UNLOADING, NodeState.UNLOADED]
        assert list(sys.view.containers["/c"].nodes) == [NodeKey("/c", "/a")]
