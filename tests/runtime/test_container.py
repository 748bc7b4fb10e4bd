from __future__ import annotations

import asyncio

import pytest
from msgspec.structs import replace

from play_launch.config.model import OnExit
from play_launch.container.channel import ChannelClosedError
from play_launch.container.codec import ControlError
from play_launch.container.messages import (
    Load,
)
from play_launch.process.exit import Exit
from play_launch.runtime.launcher import StartError
from play_launch.supervisor.events import (
    ComponentEventKind,
    ContainerState,
    NodeState,
    ProcessEventKind,
)

from .fakes import FakeContainer, FakeLauncher, Held, container, system
from .running import running


def launcher(*makers: type[FakeContainer]) -> FakeLauncher:
    return FakeLauncher(makers={"/c": list(makers)} if makers else {})


def loads(fake: FakeContainer) -> list[Load]:
    return [message for message in fake.link.sent if isinstance(message, Load)]


class Mute(FakeContainer):
    """Never says hello."""

    def start(self) -> None:
        pass


async def test_the_ordinary_way() -> None:
    async with running(system(container("c", "a")), launcher()) as sys:
        await sys.until_loaded(1)
    assert sys.node_states("/a") == [
        NodeState.PENDING,
        NodeState.REQUESTED,
        NodeState.LOADING,
        NodeState.LOADED,
        NodeState.UNLOADED,
    ]
    assert sys.process_events("/c") == [
        ProcessEventKind.STARTED,
        ProcessEventKind.READY,
        ProcessEventKind.STOPPING,
        ProcessEventKind.EXITED,
    ]
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0
    assert sys.launcher.containers["/c"][0].process.stopped_with == ["ask"]


async def test_a_container_that_dies_is_started_again_with_its_nodes() -> None:
    async with running(system(container("c", "a", "b")), launcher()) as sys:
        await sys.until_loaded(2)
        sys.launcher.containers["/c"][0].crash()
        await sys.until_state("/c", ContainerState.BACKOFF)
        assert {node.state for node in sys.view.containers["/c"].nodes.values()} == {NodeState.LOST}
        await sys.until_loaded(2)
    first, second = sys.launcher.containers["/c"]
    assert {load.attempt for load in loads(first)}.isdisjoint(
        load.attempt for load in loads(second)
    )
    assert "signal 11" in sys.node_events("/a", NodeState.LOST)[0].reason
    assert sys.view.containers["/c"].process.restarts == 1
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0


async def test_what_it_said_before_it_died_counts() -> None:
    class FailsAndDies(FakeContainer):
        def construct(self, held: Held) -> None:
            # The socket is read a little later than the end is seen.
            asyncio.get_running_loop().call_later(0.1, self.last_words, held)
            self.process.on_end = lambda: None
            self.process.end(Exit(code=1))

        def last_words(self, held: Held) -> None:
            self.say(ComponentEventKind.LOAD_FAILED, held, error="no memory")
            self.link.say(ChannelClosedError("closed"))

    config = system(container("c", "a", max_restarts=0))
    async with running(config, launcher(FailsAndDies)) as sys:
        await sys.until_state("/c", ContainerState.GAVE_UP)
    assert sys.node_events("/a", NodeState.LOAD_FAILED)[0].reason == "no memory"


async def test_it_dies_in_the_middle_of_loading() -> None:
    class DiesLoading(FakeContainer):
        def on_load(self, load: Load) -> None:
            if load.node_name == "b":
                self.crash(6)
            else:
                super().on_load(load)

    async with running(
        system(container("c", "a", "b", "x")), launcher(DiesLoading, FakeContainer)
    ) as sys:
        await sys.until_loaded(3)
        assert len(sys.launcher.containers["/c"]) == 2


async def test_restarts_are_bounded_and_then_it_is_given_up_loudly(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Dies(FakeContainer):
        def start(self) -> None:
            self.crash(6)

    async with running(system(container("c", "a")), launcher(Dies)) as sys:
        await sys.stop.requested.wait()
    assert len(sys.launcher.containers["/c"]) == 4
    assert sys.container_states("/c")[-1] is ContainerState.GAVE_UP
    assert sys.process_events("/c")[-1] is ProcessEventKind.GAVE_UP
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 1
    assert sys.stop.reason == "nothing is left to run"
    assert "/c is not started again: exited with signal 6" in caplog.text


@pytest.mark.parametrize("code", [64, 126, 127])
async def test_what_cannot_get_better_is_not_tried_again(code: int) -> None:
    class Refuses(FakeContainer):
        def start(self) -> None:
            self.process.end(Exit(code=code))

    async with running(system(container("c", "a")), launcher(Refuses)) as sys:
        await sys.until_state("/c", ContainerState.GAVE_UP)
        assert len(sys.launcher.containers["/c"]) == 1


@pytest.mark.parametrize("permanent", [True, False])
async def test_it_cannot_be_started(permanent: bool) -> None:
    fakes = FakeLauncher(failures={"/c": StartError("no file", permanent=permanent)})
    async with running(system(container("c", "a")), fakes) as sys:
        await sys.until_state("/c", ContainerState.GAVE_UP)
    assert sys.container_states("/c").count(ContainerState.BACKOFF) == (0 if permanent else 3)
    assert "no file" in sys.view.containers["/c"].reason


async def test_it_never_says_hello() -> None:
    async with running(system(container("c", "a")), launcher(Mute, FakeContainer)) as sys:
        await sys.until_loaded(1)
        assert sys.launcher.containers["/c"][0].process.exit == Exit(signal=9)
        backoff = sys.container_events("/c", ContainerState.BACKOFF)
        assert "did not say hello" in backoff[0].reason


async def test_it_speaks_another_version() -> None:
    class Foreign(FakeContainer):
        def start(self) -> None:
            self.link.say(self.hello(protocol_version=99))

    async with running(system(container("c", "a")), launcher(Foreign)) as sys:
        await sys.until_state("/c", ContainerState.GAVE_UP)
        fake = sys.launcher.containers["/c"][0]
        assert await fake.process.wait() == Exit(signal=9)
        assert not fake.link.sent
        assert "version 99" in sys.view.containers["/c"].reason


async def test_it_talks_nonsense() -> None:
    class Babbles(FakeContainer):
        def on_load(self, load: Load) -> None:
            self.link.say(ControlError("a frame of 4 GiB"))

    async with running(system(container("c", "a")), launcher(Babbles, FakeContainer)) as sys:
        await sys.until_loaded(1)
        assert sys.launcher.containers["/c"][0].process.exit == Exit(signal=9)


async def test_it_closes_the_channel_and_lives_on() -> None:
    class HangsUp(FakeContainer):
        def on_load(self, load: Load) -> None:
            self.process.on_end()

    async with running(system(container("c", "a")), launcher(HangsUp, FakeContainer)) as sys:
        await sys.until_loaded(1)
        assert sys.launcher.containers["/c"][0].process.exit == Exit(signal=9)


async def test_containers_start_in_parallel_but_not_all_at_once() -> None:
    names = [f"/c{number}" for number in range(10)]
    fakes = FakeLauncher(makers={name: [Mute] for name in names})
    config = system(*(container(name[1:], "a") for name in names))
    async with running(config, fakes, starts=4) as sys:
        for greeted, started in ((0, 4), (4, 8), (8, 10)):
            await sys.until(lambda started=started: len(fakes.containers) >= started)  # type: ignore[misc]
            assert len(fakes.containers) == started
            for name in names[greeted:started]:
                fakes.containers[name][0].link.say(fakes.containers[name][0].hello())
            await sys.until_loaded(started)


async def test_the_end_of_a_container_may_be_that_of_the_system() -> None:
    config = system(replace(container("c", "a"), on_exit=OnExit.SHUTDOWN), container("d", "b"))
    async with running(config, launcher()) as sys:
        await sys.until_loaded(2)
        sys.launcher.containers["/c"][0].crash()
        await sys.until_stopped()
    assert sys.process_events("/c").count(ProcessEventKind.STARTED) == 1
    assert sys.process_events("/d")[-1] is ProcessEventKind.EXITED
    assert sys.outcome is not None
    assert (sys.stop.reason, sys.outcome.exit_code) == ("/c has ended", 1)
