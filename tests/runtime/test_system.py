from __future__ import annotations

import asyncio
import signal

import pytest
from msgspec.structs import replace

from play_launch.config.model import OnExit, ProcessConfig
from play_launch.process.exit import Exit
from play_launch.process.lines import OutputCallback
from play_launch.runtime.publisher import Publisher
from play_launch.runtime.run import RunOutcome, run_system
from play_launch.runtime.signals import StopRequests
from play_launch.supervisor.events import (
    ContainerState,
    NodeState,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
)
from play_launch.supervisor.view import SystemView

from .fakes import (
    FakeContainer,
    FakeLauncher,
    FakeProcess,
    Held,
    container,
    process,
    system,
)
from .jumping_loop import run
from .running import Running, running

CONFIG = system(
    container("good", "a", "b"),
    container("mute", "x"),
    container("slow", "s"),
    container("dies", "d"),
    process("p"),
    process("q", on_exit=OnExit.RESTART),
)


class Mute(FakeContainer):
    def start(self) -> None:
        pass


class Slow(FakeContainer):
    def construct(self, held: Held) -> None:
        pass


class Dies(FakeContainer):
    def construct(self, held: Held) -> None:
        self.crash()


class DeafToShutdown(FakeContainer):
    def on_shutdown(self) -> None:
        pass


def launcher() -> FakeLauncher:
    def ends(started: FakeProcess) -> None:
        if started.argv == ("q",):
            started.end(Exit(code=1))

    return FakeLauncher(makers={"/mute": [Mute], "/slow": [Slow], "/dies": [Dies]}, on_process=ends)


class StopAt:
    """Requests the stop, or cancels, out of the n-th event."""

    def __init__(self, count: int, act: list[str], stop: StopRequests) -> None:
        self.left = count
        self.act = act
        self.stop = stop
        self.task: asyncio.Task[RunOutcome] | None = None

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        self.left -= 1
        if self.left == 0:
            for act in self.act:
                if act == "cancel":
                    assert self.task is not None
                    self.task.cancel()
                else:
                    self.stop.request(signal.SIGINT)


@pytest.mark.parametrize("act", [["stop"], ["stop", "stop"], ["cancel"]], ids="-".join)
@pytest.mark.parametrize("count", range(1, 60))
async def test_a_stop_at_any_moment_leaves_nothing(count: int, act: list[str]) -> None:
    fakes, stop = launcher(), StopRequests()
    sink = StopAt(count, act, stop)
    sink.task = asyncio.create_task(
        run_system(CONFIG, Publisher(sink), stop, launcher=fakes, starts=2)
    )
    try:
        outcome = await sink.task
    except asyncio.CancelledError:
        assert act == ["cancel"]
    else:
        assert outcome.exit_code == 128 + signal.SIGINT
    assert sink.left <= 0, "the run did not get that far"
    assert not fakes.alive()
    assert fakes.closed


async def test_a_stop_that_came_before_the_start_starts_nothing() -> None:
    fakes, stop = launcher(), StopRequests()
    stop.request(signal.SIGTERM)
    outcome = await run_system(CONFIG, Publisher(StopAt(0, [], stop)), stop, launcher=fakes)
    assert outcome.exit_code == 143
    assert not fakes.containers
    assert not fakes.processes


@pytest.mark.parametrize("count", range(1, 60))
async def test_a_fault_of_our_own_costs_one_member_at_most_and_leaves_nothing(count: int) -> None:
    class Breaks(Publisher):
        left = count

        def publish(self, event: RunEvent) -> None:
            self.left -= 1
            if self.left == 0:
                raise LookupError("a bug")
            super().publish(event)

    fakes = launcher()
    sink = Running(fakes)
    config = replace(CONFIG, duration=60.0)
    try:
        await run_system(config, Breaks(sink), sink.stop, launcher=fakes, starts=2)
    except LookupError:
        assert not fakes.containers, "members are announced before anything starts"
        assert not fakes.processes
    assert not fakes.alive()
    assert fakes.closed
    assert sum("LookupError" in reason for reason in sink.gave_up().values()) <= 1


async def test_a_sink_that_fails_gets_no_more_events_and_costs_no_member(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Breaks:
        given = 0

        def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
            self.given += 1
            if isinstance(event, ProcessEvent) and event.kind is ProcessEventKind.STARTED:
                raise LookupError("a bug")

    fakes = FakeLauncher()
    async with running(system(container("c", "a"), process("p")), fakes) as sys:
        sink = Breaks()
        sys.publisher.add_sink(sink)
        await sys.until_loaded(1)
        await sys.until(lambda: ProcessEventKind.STARTED in sys.process_events("/p"))
        assert sink.given < len(sys.events)
    assert not sys.gave_up()
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0
    assert caplog.text.count("Breaks failed and gets no more events") == 1


async def test_a_fault_of_our_own_stops_its_process_in_order_and_no_other() -> None:
    class Unheard(FakeProcess):
        async def wait(self) -> Exit:
            if "bug" not in self.stopped_with:
                self.stopped_with.append("bug")
                raise LookupError("a bug")
            return await super().wait()

    class Launcher(FakeLauncher):
        async def start_process(
            self, config: ProcessConfig, on_output: OutputCallback
        ) -> FakeProcess:
            started = await super().start_process(config, on_output)
            if config.name == "bad":
                started.__class__ = Unheard
            return started

    async with running(system(process("bad"), process("good")), Launcher()) as sys:
        await sys.until(lambda: "/bad" in sys.gave_up())
        assert not sys.launcher.processes["/good"][0].stopped_with
        sys.stop.request(reason="the test is over")
    assert sys.launcher.processes["/bad"][0].stopped_with == ["bug", "SIGINT"]
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 1


async def test_a_start_that_is_not_answered_holds_up_no_restart_and_no_end() -> None:
    class Unanswered(FakeLauncher):
        """The first start of each is not answered."""

        async def start_process(
            self, config: ProcessConfig, on_output: OutputCallback
        ) -> FakeProcess:
            if config.full_name not in awaited:
                awaited.append(config.full_name)
                begun.set()
                await asyncio.Event().wait()
            return await super().start_process(config, on_output)

    awaited: list[str] = []
    begun = asyncio.Event()

    async with running(system(process("again"), process("never")), Unanswered()) as sys:
        await begun.wait()
        sys.operated.restart("/again", "a restart")
        await sys.until(lambda: ProcessEventKind.STARTED in sys.process_events("/again"))
    assert sorted(awaited) == ["/again", "/never"]
    assert len(sys.launcher.processes["/again"]) == 1
    assert "/never" not in sys.launcher.processes
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0


async def test_it_is_told_to_shut_down_before_it_is_sent_signals() -> None:
    fakes = FakeLauncher(makers={"/c": [DeafToShutdown]})
    async with running(system(container("c", "a")), fakes) as sys:
        await sys.until_loaded(1)
    assert sys.launcher.containers["/c"][0].process.stopped_with == ["ask", "SIGINT"]
    assert sys.container_states("/c")[-2:] == [ContainerState.STOPPING, ContainerState.STOPPED]


async def test_a_container_without_a_hello_is_not_requested_to_end() -> None:
    fakes = FakeLauncher(makers={"/c": [Mute]})
    async with running(system(container("c", "a")), fakes) as sys:
        await sys.until(lambda: bool(sys.process_events("/c")))
    assert sys.launcher.containers["/c"][0].process.stopped_with == ["SIGINT"]


def test_all_stop_in_parallel_and_a_second_request_hurries() -> None:
    async def main(requests: int) -> float:
        class Deaf(DeafToShutdown):
            def start(self) -> None:
                super().start()
                self.process.deaf_to = {"SIGINT"}

        names = [f"c{number}" for number in range(8)]
        fakes = FakeLauncher(makers={f"/{name}": [Deaf] for name in names})
        async with running(system(*(container(each, "a") for each in names)), fakes) as sys:
            await sys.until_loaded(8)
            before = asyncio.get_running_loop().time()
            for _ in range(requests):
                sys.stop.request(signal.SIGINT)
            await sys.until_stopped()
        return asyncio.get_running_loop().time() - before

    assert run(main(1)) == pytest.approx(4.0)
    assert run(main(2)) < 1.0


async def stop_with(*requests: int | None) -> StopRequests:
    stop = StopRequests()
    for signum in requests:
        stop.request(signum, "" if signum else "a node crashed")
    return stop


@pytest.mark.parametrize(
    ("requests", "hurries"),
    [
        ((None, None, None), False),
        ((None, signal.SIGINT), False),
        ((signal.SIGINT, None), False),
        ((signal.SIGINT, signal.SIGINT), True),
        ((None, signal.SIGINT, signal.SIGTERM), True),
        ((signal.SIGHUP, None, signal.SIGINT), True),
    ],
)
def test_only_a_second_signal_hurries(requests: tuple[int | None, ...], hurries: bool) -> None:
    stop = run(stop_with(*requests))
    assert stop.requested.is_set()
    assert stop.hurry.is_set() is hurries
    assert stop.signum == requests[0]


async def test_the_duration_ends_a_run() -> None:
    async with running(system(container("c", "a"), duration=30.0), FakeLauncher()) as sys:
        await sys.stop.requested.wait()
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0
    assert sys.stop.reason == "its duration of 30 s is over"
    assert sys.outcome.view.loaded == 1
    assert sys.outcome.view.containers["/c"].state is ContainerState.RUNNING
    assert sys.outcome.final_view.containers["/c"].state is ContainerState.STOPPED


async def test_what_dead_processes_left_is_removed_before_the_start_and_after_the_end() -> None:
    fakes = FakeLauncher()
    async with running(system(container("c", "a"), duration=1.0), fakes) as sys:
        await sys.stop.requested.wait()
    assert fakes.cleaned_before_a_start == [1]
    assert fakes.cleaned == 2


async def test_nothing_to_run_ends_at_once() -> None:
    async with running(system(), FakeLauncher()) as sys:
        await sys.stop.requested.wait()
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0


async def test_everything_that_is_declared_is_known_from_the_start() -> None:
    async with running(CONFIG, launcher()) as sys:
        await sys.until(lambda: bool(sys.process_events("/good")))
        states = {node.state for node in sys.view.waiting}
        assert (sys.view.total, states) == (5, {NodeState.PENDING})
    assert ProcessEventKind.STARTED in sys.process_events("/p")
