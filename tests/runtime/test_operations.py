"""What can be asked of a running system: of one member or node, with the others left alone."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest

from play_launch.config.node_key import NodeKey
from play_launch.container.codec import ControlError
from play_launch.process.exit import Exit
from play_launch.supervisor.events import ContainerState, NodeState, ProcessEventKind

from .fakes import FakeContainer, FakeLauncher, FakeProcess, Held, container, process, system
from .running import Running, running

if TYPE_CHECKING:
    from play_launch.container.messages import Load

A, B = NodeKey("/c", "/a"), NodeKey("/c", "/b")
CONFIG = system(container("c", "a", "b"), container("d", "x"), process("p"))


def pids(fakes: FakeLauncher) -> dict[str, list[int]]:
    containers = {name: [e.process.pid for e in all_] for name, all_ in fakes.containers.items()}
    return {**containers, **{name: [e.pid for e in all_] for name, all_ in fakes.processes.items()}}


async def until_up(sys: Running) -> None:
    await sys.until_loaded(3)
    await sys.until(lambda: ProcessEventKind.STARTED in sys.process_events("/p"))


async def test_a_container_is_stopped_and_started_and_the_others_run_on() -> None:
    async with running(CONFIG, FakeLauncher()) as sys:
        await until_up(sys)
        before = pids(sys.launcher)
        sys.operated.stop("/c", "for a test")
        await sys.until_state("/c", ContainerState.STOPPED)
        assert sys.launcher.containers["/c"][0].process.stopped_with == ["ask"]
        assert sys.container_events("/c", ContainerState.STOPPING)[0].reason == "for a test"
        assert sys.view.loaded == 1
        sys.operated.start("/c")
        await sys.until_loaded(3)
        after = pids(sys.launcher)
        assert len(after.pop("/c")) == 2
        assert after == {name: before[name] for name in ("/d", "/p")}


@pytest.mark.parametrize("name", ["/c", "/p"])
async def test_a_member_is_restarted(name: str) -> None:
    async with running(CONFIG, FakeLauncher()) as sys:
        await until_up(sys)
        before = pids(sys.launcher)
        sys.operated.restart(name, "for a test")
        await sys.until(lambda: len(pids(sys.launcher)[name]) == 2)
        await sys.until_loaded(3)
        after = pids(sys.launcher)
        del before[name], after[name]
        assert after == before
        assert ProcessEventKind.RESTARTING not in sys.process_events(name)


async def test_a_unit_that_is_started_while_it_stops_starts_when_it_has_ended() -> None:
    async with running(CONFIG, FakeLauncher()) as sys:
        await until_up(sys)
        sys.operated.stop("/c", "first")
        sys.operated.start("/c")
        sys.operated.stop("/p", "first")
        sys.operated.start("/p")
        await sys.until(lambda: all(len(pids(sys.launcher)[each]) == 2 for each in ("/c", "/p")))
        await sys.until_loaded(3)


async def test_a_unit_that_is_stopped_before_its_turn_never_starts() -> None:
    class Mute(FakeContainer):
        def start(self) -> None:
            pass

    fakes = FakeLauncher(makers={"/c": [Mute]})
    async with running(CONFIG, fakes, starts=1) as sys:
        await sys.until(lambda: bool(fakes.containers))
        for _ in range(3):
            sys.operated.stop("/d", "not now")
            await sys.until_state("/d", ContainerState.STOPPED)
            sys.operated.start("/d")
            await sys.until_state("/d", ContainerState.STARTING)
        sys.operated.stop("/d", "not now")
        await sys.until_state("/d", ContainerState.STOPPED)
        fakes.containers["/c"][0].link.say(fakes.containers["/c"][0].hello())
        await sys.until_loaded(2)
        assert list(fakes.containers) == ["/c"]
        sys.operated.start("/d")
        await sys.until_loaded(3)
        assert len(fakes.containers["/d"]) == 1


@pytest.mark.parametrize("name", ["/c", "/p"])
async def test_a_unit_that_is_stopped_while_its_last_process_ends_comes_to_rest(
    name: str,
) -> None:
    async with running(CONFIG, FakeLauncher()) as sys:
        await until_up(sys)
        for each in sys.launcher.alive():
            each.lingers = 1.0
        sys.operated.restart(name, "for a test")
        await sys.until(lambda: ProcessEventKind.EXITED in sys.process_events(name))
        await asyncio.sleep(0.1)
        sys.operated.stop(name, "not now")
        await asyncio.sleep(5)
        assert len(pids(sys.launcher)[name]) == 1
        sys.operated.start(name)
        await sys.until(lambda: len(pids(sys.launcher)[name]) == 2)


async def test_nonsense_among_the_last_frames_kills_no_later_process() -> None:
    class DiesBabbling(FakeContainer):
        def crash(self, signal: int = 11) -> None:
            self.process.on_end = lambda: None
            super().crash(signal)
            self.link.say(ControlError("a frame of 4 GiB"))

    fakes = FakeLauncher(makers={"/c": [DiesBabbling, FakeContainer]})
    async with running(system(container("c", "a")), fakes) as sys:
        await sys.until_loaded(1)
        fakes.containers["/c"][0].crash()
        await sys.until_state("/c", ContainerState.BACKOFF)
        await sys.until_loaded(1)
        await asyncio.sleep(10)
        assert sys.view.loaded == 1
        assert not fakes.containers["/c"][1].process.stopped_with
        assert not sys.gave_up()
        assert ProcessEventKind.STOPPING not in sys.process_events("/c")


async def test_a_fault_while_cleaning_up_after_a_member_does_not_hold_up_the_end() -> None:
    class Fails(FakeLauncher):
        async def clean_up(self) -> None:
            await super().clean_up()
            if self.cleaned == 2:
                raise OSError("no space")

    async with running(system(container("c", "a"), process("p")), Fails()) as sys:
        await sys.until_loaded(1)
        sys.launcher.containers["/c"][0].crash()
        await sys.until_state("/c", ContainerState.GAVE_UP)
        sys.stop.request(reason="the test is over")
        async with asyncio.timeout(60):
            await sys.until_stopped()


async def test_a_node_that_is_loaded_by_hand_gets_its_reloads_anew() -> None:
    async with running(system(container("c", "a")), FakeLauncher()) as sys:

        async def crash_after_load(count: int) -> None:
            await sys.until(lambda: len(sys.node_events("/a", NodeState.LOADED)) == count)
            sys.launcher.containers["/c"][0].crash_node("a")

        for count in range(1, 5):
            await crash_after_load(count)
        await sys.until(lambda: bool(sys.node_events("/a", NodeState.GAVE_UP)))
        sys.operated.start(A)
        await crash_after_load(5)
        await sys.until(lambda: len(sys.node_events("/a", NodeState.LOADED)) == 6)
        assert len(sys.node_events("/a", NodeState.GAVE_UP)) == 1


async def test_a_member_that_gave_up_can_be_started() -> None:
    class Dies(FakeContainer):
        def start(self) -> None:
            self.crash(6)

    # The fifth start is the one that is asked for; its restarts count from there.
    fakes = FakeLauncher(makers={"/c": [Dies, Dies, Dies, Dies, Dies, Dies, FakeContainer]})
    async with running(CONFIG, fakes) as sys:
        await sys.until_state("/c", ContainerState.GAVE_UP)
        assert len(fakes.containers["/c"]) == 4
        sys.operated.start("/c")
        await sys.until_loaded(3)
        assert len(fakes.containers["/c"]) == 7


async def test_a_pause_before_a_restart_is_cut_short() -> None:
    async with running(CONFIG, FakeLauncher()) as sys:
        await until_up(sys)
        sys.launcher.containers["/c"][0].crash()
        await sys.until_state("/c", ContainerState.BACKOFF)
        sys.operated.start("/c")
        await sys.until_loaded(3)
        assert len(sys.launcher.containers["/c"]) == 2


async def test_a_node_is_unloaded_and_stays_away_until_it_is_loaded() -> None:
    async with running(CONFIG, FakeLauncher()) as sys:
        await until_up(sys)
        sys.operated.stop(A)
        await sys.until(lambda: bool(sys.node_events("/a", NodeState.UNLOADED)))
        sys.launcher.containers["/c"][0].crash()
        await sys.until_state("/c", ContainerState.BACKOFF)
        await sys.until_loaded(2)
        assert sys.view.containers["/c"].nodes[A].state is NodeState.UNLOADED
        sys.operated.start(A)
        await sys.until_loaded(3)


async def test_a_node_that_is_wanted_again_while_its_container_is_away_comes_with_it() -> None:
    async with running(CONFIG, FakeLauncher()) as sys:
        await until_up(sys)
        sys.operated.stop(A)
        await sys.until_loaded(2)
        sys.operated.stop("/c", "for a test")
        await sys.until_state("/c", ContainerState.STOPPED)
        sys.operated.start(A)
        sys.operated.stop(B)
        sys.operated.start("/c")
        await sys.until_loaded(2)
        states = [node.state for node in sys.view.containers["/c"].nodes.values()]
        assert states == [NodeState.LOADED, NodeState.UNLOADED]


@pytest.mark.parametrize("key", [NodeKey("/c", "/x"), NodeKey("/absent", "/a")])
async def test_an_operation_on_an_unknown_node_is_refused_to_its_caller(key: NodeKey) -> None:
    async with running(CONFIG, FakeLauncher()) as sys:
        await until_up(sys)
        for operation in (sys.operated.start, sys.operated.stop, sys.operated.restart):
            with pytest.raises(KeyError):
                operation(key)
        assert sys.view.is_complete


async def test_a_node_is_reloaded_and_its_neighbour_is_left_alone() -> None:
    async with running(CONFIG, FakeLauncher()) as sys:
        await until_up(sys)
        neighbour = sys.view.containers["/c"].nodes[B].unique_id
        sys.operated.restart(A)
        await sys.until(lambda: len(sys.node_events("/a", NodeState.LOADED)) == 2)
        assert sys.node_states("/a")[-4:] == [
            NodeState.UNLOADING,
            NodeState.REQUESTED,
            NodeState.LOADING,
            NodeState.LOADED,
        ]
        assert sys.view.containers["/c"].nodes[B].unique_id == neighbour
        assert not sys.view.crashed


async def test_a_reload_that_the_container_forgets_twice_is_followed_up_like_the_crash() -> None:
    class Forgets(FakeContainer):
        def on_load(self, load: Load) -> None:
            if not 1 <= self.loads_of(load.node_name) <= 2:
                super().on_load(load)
            self.seen.append(load.node_name)

        def loads_of(self, name: str) -> int:
            return self.seen.count(name)

        def start(self) -> None:
            self.seen: list[str] = []
            super().start()

    async with running(system(container("c", "a")), FakeLauncher({"/c": [Forgets]})) as sys:
        await sys.until_loaded(1)
        sys.launcher.containers["/c"][0].crash_node("a")
        await sys.until(lambda: bool(sys.node_events("/a", NodeState.CRASHED)))
        await sys.until_loaded(1)
    failed = sys.node_events("/a", NodeState.LOAD_FAILED)
    assert len(failed) == 1
    assert "does not know it" in failed[0].reason


async def test_a_frozen_container_is_killed_once_whatever_is_found_besides() -> None:
    class Immortal(FakeProcess):
        def kill(self) -> None:
            self.stopped_with.append("kill")

    class Frozen(FakeContainer):
        def construct(self, held: Held) -> None:
            super().construct(held)
            self.process.__class__ = Immortal
            self.on_watch = lambda query: None  # type: ignore[method-assign]

    async with running(system(container("c", "a")), FakeLauncher({"/c": [Frozen]})) as sys:
        await sys.until_state("/c", ContainerState.KILLING)
        await sys.until_state("/c", ContainerState.GAVE_UP)
        assert sys.launcher.containers["/c"][0].process.stopped_with == ["kill"]
        assert "does not die" in sys.view.containers["/c"].reason
        sys.stop.request(reason="the test is over")
        await sys.until_stopped()
        sys.launcher.containers["/c"][0].process.end(Exit(signal=9))
    assert sys.process_events("/c").count(ProcessEventKind.STOPPING) == 1
    assert sys.process_events("/c").count(ProcessEventKind.GAVE_UP) == 1
