"""A running system becomes another one, and what is the same in both is left alone."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, TypeVar

import pytest
from msgspec.structs import replace

from play_launch.config.model import (
    ContainerType,
    OnCrash,
    ParameterConfig,
    ParameterType,
    ParameterValue,
)
from play_launch.container.messages import Load, Unload
from play_launch.runtime.applying import BusyError
from play_launch.runtime.launcher import StartError
from play_launch.supervisor.events import (
    ComponentEventKind,
    ContainerState,
    NodeState,
    SubjectKind,
    Withdrawn,
)
from play_launch.supervisor.plan import Applied, PlanAction, PlanKind, Result

from .fake_parameters import FakeParameters
from .fakes import (
    FakeContainer,
    FakeLauncher,
    Held,
    container,
    node,
    process,
    system,
)
from .running import running

if TYPE_CHECKING:
    pass


def rate(value: int) -> tuple[ParameterConfig, ...]:
    return (ParameterConfig("rate", ParameterValue(ParameterType.INTEGER, value)),)


_Message = TypeVar("_Message", Load, Unload)


def sent(launcher: FakeLauncher, name: str, kind: type[_Message]) -> list[_Message]:
    (only,) = launcher.containers[name]
    return [each for each in only.link.sent if isinstance(each, kind)]


def results(applied: Applied) -> dict[str, Result]:
    return {each.step.name: each.result for each in applied.outcomes}


async def test_a_node_comes_and_goes_beside_others_that_notice_nothing() -> None:
    launcher = FakeLauncher()
    before = system(container("box", "stays", "goes"), container("other", "n"))
    async with running(before, launcher) as run:
        await run.until_loaded(3)
        target = system(container("box", "stays", "comes"), container("other", "n"))
        applied = await run.operated.applying.apply(target)
        assert results(applied) == {"/box:/goes": Result.DONE, "/box:/comes": Result.DONE}
        assert [each.node_name for each in sent(launcher, "/box", Load)] == [
            "stays",
            "goes",
            "comes",
        ]
        assert len(sent(launcher, "/box", Unload)) == 1
        assert len(sent(launcher, "/other", Load)) == 1
        box = run.view.containers["/box"]
        assert [key.name for key in box.nodes] == ["/stays", "/comes"]
        assert run.view.is_complete
        assert run.node_states("/stays").count(NodeState.REQUESTED) == 1
        assert not (await run.operated.applying.apply(target)).outcomes
    assert run.outcome is not None
    assert run.outcome.exit_code == 0


async def test_members_come_and_go() -> None:
    launcher = FakeLauncher()
    before = system(container("stays", "n"), container("goes", "m"), process("old"))
    async with running(before, launcher) as run:
        await run.until_loaded(2)
        target = system(container("stays", "n"), container("comes", "k"), process("new"))
        assert (await run.operated.applying.apply(target)).succeeded
        assert list(run.view.containers) == ["/stays", "/comes"]
        assert list(run.view.processes) == ["/new"]
        assert run.view.loaded == run.view.total == 2
        assert len(launcher.containers["/stays"]) == 1
        assert launcher.processes["/old"][0].exit is not None
        gone = [(each.kind, each.key) for each in run.events if isinstance(each, Withdrawn)]
        assert sorted(gone) == [
            (SubjectKind.NODE, "/goes:/m"),
            (SubjectKind.CONTAINER, "/goes"),
            (SubjectKind.PROCESS, "/old"),
        ]
    assert run.outcome is not None
    # It had ended by a signal, but it belongs to the system no more.
    assert run.outcome.exit_code == 0


async def test_a_container_of_another_type_is_a_new_process_with_its_new_nodes() -> None:
    launcher = FakeLauncher()
    async with running(system(container("box", "a", "b")), launcher) as run:
        await run.until_loaded(2)
        box = replace(container("box", "b", "c"), container_type=ContainerType.MT)
        applied = await run.operated.applying.apply(system(box))
        assert results(applied) == {"/box": Result.DONE}
        first, second = launcher.containers["/box"]
        assert first.process.exit is not None
        assert second.config.container_type is ContainerType.MT
        assert [key.name for key in run.view.containers["/box"].nodes] == ["/b", "/c"]
        assert run.view.is_complete


async def test_a_changed_node_is_loaded_anew_as_it_is_declared_now() -> None:
    launcher = FakeLauncher()
    async with running(system(container("box", "a", "b")), launcher) as run:
        await run.until_loaded(2)
        changed = replace(node("a"), remappings=(("x", "y"),))
        assert (await run.operated.applying.apply(system(container("box", changed, "b")))).succeeded
        loads = sent(launcher, "/box", Load)
        assert [each.node_name for each in loads] == ["a", "b", "a"]
        assert loads[-1].remap_rules == ("x:=y",)
        # And so it is after a crash.
        launcher.containers["/box"][0].crash_node("a")
        await run.until(lambda: len(sent(launcher, "/box", Load)) == 4)
        assert sent(launcher, "/box", Load)[-1].remap_rules == ("x:=y",)


async def test_a_parameter_is_set_where_the_node_takes_it_and_else_it_is_loaded_anew() -> None:
    launcher, parameters = FakeLauncher(), FakeParameters()
    parameters.refusals["/b"] = "rate is read-only"
    before = system(container("box", "a", "b"), process("p"))
    async with running(before, launcher, parameters=parameters) as run:
        await run.until_loaded(2)
        a, b = (replace(node(name), parameters=rate(2)) for name in "ab")
        target = system(container("box", a, b), replace(process("p"), parameters=rate(3)))
        applied = await run.operated.applying.apply(target)
        assert applied.succeeded
        assert sorted(parameters.taken) == [("/a", "rate", 2), ("/p", "rate", 3)]
        reasons = {each.step.name: each.reason for each in applied.outcomes}
        assert reasons["/box:/b"] == "reloaded: rate is read-only"
        loads = sent(launcher, "/box", Load)
        assert [each.node_name for each in loads] == ["a", "b", "b"]
        assert loads[-1].parameters == rate(2)
        assert len(launcher.processes["/p"]) == 1
        # What was set holds for its next life as well.
        launcher.containers["/box"][0].crash_node("a")
        await run.until(lambda: len(sent(launcher, "/box", Load)) == 4)
        assert sent(launcher, "/box", Load)[-1].parameters == rate(2)


async def test_limits_are_taken_over_without_a_word_to_the_container() -> None:
    launcher = FakeLauncher()
    async with running(system(container("box", "a")), launcher) as run:
        await run.until_loaded(1)
        said = len(launcher.containers["/box"][0].link.sent)
        target = system(container("box", node("a", OnCrash.IGNORE), max_restarts=0))
        applied = await run.operated.applying.apply(target)
        assert {each.step.action for each in applied.outcomes} == {PlanAction.ADOPT}
        assert len(launcher.containers["/box"][0].link.sent) == said
        launcher.containers["/box"][0].crash_node("a")
        await run.until(lambda: run.node_states("/a")[-1] is NodeState.CRASHED)
        launcher.containers["/box"][0].crash()
        await run.until_state("/box", ContainerState.GAVE_UP)
    assert run.node_states("/a").count(NodeState.REQUESTED) == 1


class Refusing(FakeContainer):
    def construct(self, held: Held) -> None:
        if held.load.node_name == "bad":
            del self.held[held.unique_id]
            self.say(ComponentEventKind.LOAD_FAILED, held, error="no such class")
        else:
            super().construct(held)


async def test_a_failing_step_ends_it_and_leaves_the_rest_as_it_was() -> None:
    launcher = FakeLauncher({"/box": [Refusing]})
    before = system(container("box", "a", "old"))
    async with running(before, launcher) as run:
        await run.until_loaded(2)
        changed = replace(node("a"), remappings=(("x", "y"),))
        bad = system(container("box", changed, replace(node("bad"))), container("more", "m"))
        applied = await run.operated.applying.apply(bad)
        assert results(applied) == {
            "/box:/old": Result.DONE,
            "/box:/a": Result.DONE,
            "/box:/bad": Result.FAILED,
            "/more": Result.DONE,
        }
        (why,) = [each.reason for each in applied.outcomes if each.result is Result.FAILED]
        assert "no such class" in why
        # What failed is what is left to do; nothing else is touched again.
        left = run.operated.applying.plan(bad)
        assert [(step.name, step.action) for step in left.steps] == [("/box:/bad", PlanAction.LOAD)]


async def test_what_comes_after_a_failure_is_not_begun() -> None:
    launcher = FakeLauncher()
    before = system(container("box", "a"), process("p"))
    launcher_failures = {"/p": StartError("no such program", permanent=True)}
    target = system(
        container("box", "a", "b"), replace(process("p"), command=("other",)), process("q")
    )
    async with running(before, launcher) as run:
        await run.until_loaded(1)
        launcher.failures |= launcher_failures
        applied = await run.operated.applying.apply(target)
        assert results(applied) == {
            "/p": Result.FAILED,
            "/box:/b": Result.SKIPPED,
            "/q": Result.SKIPPED,
        }
        assert list(run.view.processes) == ["/p"]
        assert len(sent(launcher, "/box", Load)) == 1
        del launcher.failures["/p"]
        assert (await run.operated.applying.apply(target)).succeeded
        assert run.view.is_complete


async def test_a_failure_can_be_rolled_back() -> None:
    launcher = FakeLauncher({"/box": [Refusing]})
    before = system(container("box", "a", "old"), process("p"))
    async with running(before, launcher) as run:
        await run.until_loaded(2)
        target = system(container("box", "a", "bad"), process("q"))
        applied = await run.operated.applying.apply(target, rolls_back=True)
        assert not applied.succeeded
        assert applied.rollback is not None
        assert {each.result for each in applied.rollback} == {Result.DONE}
        assert [key.name for key in run.view.containers["/box"].nodes] == ["/a", "/old"]
        assert list(run.view.processes) == ["/p"]
        assert run.view.is_complete
        assert not run.operated.applying.plan(before).steps
        assert run.node_states("/a").count(NodeState.REQUESTED) == 1


async def test_what_takes_too_long_fails_and_may_still_come() -> None:
    class Slow(FakeContainer):
        def construct(self, held: Held) -> None:
            asyncio.get_running_loop().call_later(50, super().construct, held)

    launcher = FakeLauncher({"/slow": [Slow]})
    async with running(system(container("box", "a")), launcher) as run:
        await run.until_loaded(1)
        target = system(container("box", "a"), container("slow", "s"))
        applied = await run.operated.applying.apply(target, limit=1)
        assert [each.reason for each in applied.outcomes] == ["it takes longer than 1 s"]
        await run.until_loaded(2)
        assert not run.operated.applying.plan(target).steps


async def test_two_at_a_time_are_one_too_many() -> None:
    launcher = FakeLauncher()
    async with running(system(container("box", "a")), launcher) as run:
        await run.until_loaded(1)
        first = asyncio.create_task(
            run.operated.applying.apply(system(container("box", "a"), container("more", "m")))
        )
        await asyncio.sleep(0)
        with pytest.raises(BusyError):
            await run.operated.applying.apply(system(container("box", "a")))
        assert (await first).succeeded


async def test_everything_may_be_replaced_and_the_run_goes_on() -> None:
    launcher = FakeLauncher()
    async with running(system(process("only")), launcher) as run:
        await run.until(lambda: "/only" in run.view.processes)
        assert (await run.operated.applying.apply(system(process("next")))).succeeded
        assert not run.stop.requested.is_set()
        assert len(launcher.processes["/next"]) == 1


async def test_a_stop_ends_what_is_being_applied() -> None:
    class Never(FakeContainer):
        def construct(self, held: Held) -> None:
            pass

    launcher = FakeLauncher({"/never": [Never]})
    async with running(system(container("box", "a")), launcher) as run:
        await run.until_loaded(1)
        target = system(container("box", "a"), container("never", "n"))
        applying = asyncio.create_task(run.operated.applying.apply(target, rolls_back=True))
        await run.until_state("/never", ContainerState.RUNNING)
        run.stop.request(reason="enough")
        applied = await applying
        assert "stop" in applied.outcomes[-1].reason


async def test_a_crashed_node_is_loaded_again_although_nothing_differs() -> None:
    launcher = FakeLauncher()
    config = system(container("box", node("a", OnCrash.IGNORE), "b"))
    async with running(config, launcher) as run:
        await run.until_loaded(2)
        launcher.containers["/box"][0].crash_node("a")
        await run.until(lambda: run.node_states("/a")[-1] is NodeState.CRASHED)
        (step,) = run.operated.applying.plan(config).steps
        assert (step.kind, step.name, step.action) == (
            PlanKind.COMPONENT,
            "/box:/a",
            PlanAction.LOAD,
        )
        assert "crashed" in step.reason
        assert (await run.operated.applying.apply(config)).succeeded
        assert run.view.is_complete


async def test_a_node_that_is_taken_out_of_a_dead_container_does_not_come_back_with_it() -> None:
    launcher = FakeLauncher()
    async with running(system(container("box", "a", "b")), launcher) as run:
        await run.until_loaded(2)
        launcher.containers["/box"][0].crash()
        await run.until_state("/box", ContainerState.BACKOFF)
        assert (await run.operated.applying.apply(system(container("box", "a")))).succeeded
        await run.until_loaded(1)
        loads = launcher.containers["/box"][1].link.sent
        assert [each.node_name for each in loads if isinstance(each, Load)] == ["a"]
