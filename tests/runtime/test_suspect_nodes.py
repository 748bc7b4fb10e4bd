"""A node whose load took its container down is tried in a scratch process before the next load."""

from __future__ import annotations

import asyncio
import inspect
from typing import TYPE_CHECKING

import anyio
import pytest
from msgspec.structs import replace

from play_launch.config.model import ContainerType
from play_launch.config.node_key import NodeKey
from play_launch.container.messages import Load, Query, Status
from play_launch.control.event_words import event_object
from play_launch.process.exit import Exit
from play_launch.process.lines import Line
from play_launch.runtime.launcher import StartError
from play_launch.runtime.probes import probe_library
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    NodeState,
    OutputLine,
    Stream,
)

from .fakes import FakeContainer, FakeLauncher, FakeProcess, Held, container, found, system
from .running import Running, running

if TYPE_CHECKING:
    from play_launch.process.lines import OutputCallback

POISON = {"error": "cannot load library /lib.so", "signal": 11, "backtrace": ["init() in lib.so"]}


class Dies(FakeContainer):
    """Takes every load up at once, and dies of the first one of `bad`."""

    def on_load(self, load: Load) -> None:
        if load.node_name == "bad":
            self.crash(11)
            return
        held = self.take(load)
        asyncio.get_running_loop().call_later(0.1, self.finish, held)

    def finish(self, held: Held) -> None:
        if self.process.exit is None:
            self.construct(held)


def poison(name: str, process: FakeProcess, on_output: OutputCallback) -> None:
    found(process, on_output, **(POISON if name == "bad" else {}))


def starts(sys: Running) -> int:
    return len(sys.launcher.containers["/c"])


def probed(sys: Running) -> list[str]:
    return sorted(name for name, _ in sys.launcher.probes)


async def test_a_poisonous_library_costs_a_container_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    fakes = FakeLauncher(makers={"/c": [Dies]}, on_probe=poison)
    async with running(system(container("c", "a", "bad", "b")), fakes) as sys:
        await sys.until_loaded(2)
        await asyncio.sleep(1000)
        assert starts(sys) == 2
        assert sys.view.loaded == 2
    # All that had been sent when it died is suspected, and probed once.
    assert probed(sys) == ["a", "b", "bad"]
    (failed,) = sys.node_events("/bad", NodeState.LOAD_FAILED)
    assert failed.reason == (
        "cannot load library /lib.so at init() in lib.so (in a scratch process, tried because "
        "/c ended while it loaded the node)"
    )
    (event,) = [
        each
        for each in sys.events
        if isinstance(each, ComponentEvent) and each.kind is ComponentEventKind.LOAD_FAILED
    ]
    told = event_object(event)
    assert (told["signal"], told["backtrace"]) == (11, ("init() in lib.so",))
    assert "cannot load library /lib.so" in str(told["error_message"])
    assert told["full_node_name"] == "/bad"
    assert told["confirmed_by"] == "probe"
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 1
    assert "/c ended while it was loading /a and 2 more" in caplog.text


async def test_the_next_process_of_the_container_is_a_new_chance_for_the_library() -> None:
    verdicts = [POISON, {}]

    def replaced(name: str, process: FakeProcess, on_output: OutputCallback) -> None:
        found(process, on_output, **(verdicts.pop(0) if name == "bad" else {}))

    fakes = FakeLauncher(makers={"/c": [Dies, Dies, FakeContainer]}, on_probe=replaced)
    async with running(system(container("c", "a", "bad")), fakes) as sys:
        await sys.until(lambda: NodeState.LOAD_FAILED in sys.node_states("/bad"))
        await sys.until_loaded(1)
        sys.launcher.containers["/c"][-1].crash()
        await sys.until_loaded(2)
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0


@pytest.mark.parametrize("ending", [Exit(signal=6), Exit(code=0), Exit(code=1)])
async def test_a_scratch_process_that_says_nothing_has_died(ending: Exit) -> None:
    def mute(name: str, process: FakeProcess, on_output: OutputCallback) -> None:
        if name == "bad":
            process.end(ending)
        else:
            found(process, on_output)

    fakes = FakeLauncher(makers={"/c": [Dies]}, on_probe=mute)
    async with running(system(container("c", "bad", "b")), fakes) as sys:
        await sys.until_loaded(1)
        await sys.until(lambda: NodeState.LOAD_FAILED in sys.node_states("/bad"))
    (failed,) = sys.node_events("/bad", NodeState.LOAD_FAILED)
    assert str(ending).split()[-1] in failed.reason


async def test_a_constructor_that_takes_the_container_down_is_refused_in_the_end() -> None:
    fakes = FakeLauncher(makers={"/c": [Dies]})
    config = system(container("c", "a", "bad", "b", "x", max_restarts=5))
    async with running(config, fakes) as sys:
        await sys.until_loaded(3)
        await asyncio.sleep(1000)
        assert starts(sys) <= 4
    (failed,) = sys.node_events("/bad", NodeState.LOAD_FAILED)
    assert "it took the container down 3 times while it was loaded: exited with signal 11" in (
        failed.reason
    )
    assert not any(sys.node_events(name, NodeState.LOAD_FAILED) for name in ("/a", "/b", "/x"))
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 1


async def test_suspects_are_loaded_after_all_others() -> None:
    orders: list[list[str]] = []

    class Late(FakeContainer):
        """Has `bad` and `slow` under way when it dies of `bad`; the rest is loaded by then."""

        def start(self) -> None:
            orders.append([])
            super().start()

        def on_load(self, load: Load) -> None:
            orders[-1].append(load.node_name)
            if load.node_name not in {"bad", "slow"}:
                super().on_load(load)
            elif load.node_name == "bad":
                self.take(load)
                asyncio.get_running_loop().call_later(0.1, self.crash, 11)
            else:
                held = self.take(load)
                asyncio.get_running_loop().call_later(0.2, self.construct, held)

    config = system(container("c", "bad", "slow", "x", max_restarts=5))
    async with running(config, FakeLauncher(makers={"/c": [Late]})) as sys:
        await sys.until_loaded(2)
    assert orders[2] == ["x", "bad"]
    assert orders[3] == ["x", "slow"]


async def test_a_refused_node_comes_with_its_container_when_that_is_restarted_by_request() -> None:
    fakes = FakeLauncher(makers={"/c": [Dies, Dies, Dies, FakeContainer]})
    async with running(system(container("c", "bad", max_restarts=5)), fakes) as sys:
        await sys.until(lambda: NodeState.LOAD_FAILED in sys.node_states("/bad"))
        await sys.until_state("/c", ContainerState.RUNNING)
        sys.operated.restart("/c")
        await sys.until_loaded(1)
        assert starts(sys) == 4


async def test_a_refused_node_that_was_requested_has_its_chance_although_its_container_ends() -> (
    None
):
    class Stuck(Dies):
        """Finds a lock that stays locked while the requested load hangs."""

        hangs = False

        def on_load(self, load: Load) -> None:
            if load.node_name == "bad":
                self.hangs = True
            else:
                super().on_load(load)

        def on_watch(self, query: Query) -> None:
            locks = ("thread 12 waits",) if self.hangs else ()
            self.link.say(Status(query_id=query.query_id, dead_locks=locks))

    fakes = FakeLauncher(makers={"/c": [Dies, Dies, Stuck, FakeContainer]})
    async with running(system(container("c", "bad", max_restarts=5)), fakes) as sys:
        await sys.until(lambda: NodeState.LOAD_FAILED in sys.node_states("/bad"))
        sys.operated.start(NodeKey("/c", "/bad"))
        await sys.until_loaded(1)
        assert starts(sys) == 4


async def test_the_only_node_is_refused_after_its_second_death_and_its_container_stays() -> None:
    fakes = FakeLauncher(makers={"/c": [Dies]})
    async with running(system(container("c", "bad")), fakes) as sys:
        await sys.until(lambda: NodeState.LOAD_FAILED in sys.node_states("/bad"))
        await sys.until_state("/c", ContainerState.RUNNING)
        await asyncio.sleep(1000)
        assert starts(sys) == 3
    assert "2 times" in sys.node_events("/bad", NodeState.LOAD_FAILED)[0].reason
    assert probed(sys) == ["bad"]


@pytest.mark.parametrize("nodes", [("bad",), ("a", "bad", "b", "x")])
async def test_a_constructor_is_found_out_with_one_restart_allowed(nodes: tuple[str, ...]) -> None:
    fakes = FakeLauncher(makers={"/c": [Dies]})
    async with running(system(container("c", *nodes, max_restarts=1)), fakes) as sys:
        await sys.until(lambda: NodeState.LOAD_FAILED in sys.node_states("/bad"))
        await sys.until_loaded(len(nodes) - 1)
        await asyncio.sleep(1000)
        await sys.until_state("/c", ContainerState.RUNNING)
        # A requested start begins anew, with the same number of deaths that do not count.
        sys.operated.restart("/c")
        await sys.until(lambda: sys.node_states("/bad").count(NodeState.LOAD_FAILED) == 2)
        await asyncio.sleep(1000)
        await sys.until_state("/c", ContainerState.RUNNING)
    assert "times while it was loaded" in sys.node_events("/bad", NodeState.LOAD_FAILED)[0].reason


async def test_other_deaths_count_as_ever_after_an_inquiry() -> None:
    fakes = FakeLauncher(makers={"/c": [Dies]})
    async with running(system(container("c", "bad", "b", max_restarts=1)), fakes) as sys:
        await sys.until(lambda: NodeState.LOAD_FAILED in sys.node_states("/bad"))
        await sys.until_loaded(1)
        sys.launcher.containers["/c"][-1].crash()
        await sys.until_state("/c", ContainerState.GAVE_UP)


async def test_a_library_is_probed_once_whatever_the_number_of_its_nodes() -> None:
    fakes = FakeLauncher(
        makers={"/c": [Dies]},
        on_probe=poison,
        libraries={"a": "/one.so", "b": "/one.so", "bad": "/bad.so", "x": "/bad.so"},
    )
    async with running(system(container("c", "a", "b", "bad", "x")), fakes) as sys:
        await sys.until_loaded(2)
        await sys.until(lambda: NodeState.LOAD_FAILED in sys.node_states("/x"))
        assert starts(sys) == 2
    assert probed(sys) == ["a", "bad"]
    assert (
        len({sys.node_events(name, NodeState.LOAD_FAILED)[0].reason for name in ("/x", "/bad")})
        == 1
    )


async def test_a_component_that_its_library_lacks_does_not_speak_for_the_others() -> None:
    def lacks(name: str, process: FakeProcess, on_output: OutputCallback) -> None:
        found(process, on_output, **({"error": "it has no demo::Gone"} if name == "a" else {}))

    fakes = FakeLauncher(
        makers={"/c": [Dies, FakeContainer]},
        on_probe=lacks,
        libraries={"a": "/one.so", "b": "/one.so", "bad": "/one.so"},
    )
    config = container("c", "a", "b", "bad")
    gone = replace(config.composable_nodes[0], plugin="demo::Gone")
    config = replace(config, composable_nodes=(gone, *config.composable_nodes[1:]))
    async with running(system(config), fakes) as sys:
        await sys.until_loaded(2)
    assert probed(sys) == ["a", "b"]
    assert "it has no demo::Gone" in sys.node_events("/a", NodeState.LOAD_FAILED)[0].reason


def hangs(name: str, process: FakeProcess, on_output: OutputCallback) -> None:
    if name != "bad":
        found(process, on_output)


async def test_others_load_while_a_library_is_probed_and_the_probe_has_a_limit(
    caplog: pytest.LogCaptureFixture,
) -> None:
    fakes = FakeLauncher(makers={"/c": [Dies]}, on_probe=hangs)
    config = replace(container("c", "bad", "b"), probe_timeout=25.0)
    async with running(system(config), fakes) as sys:
        await sys.until_loaded(1)
        assert sys.view.containers["/c"].nodes[NodeKey("/c", "/bad")].state is NodeState.LOST
        assert "scratch process" in sys.view.containers["/c"].nodes[NodeKey("/c", "/bad")].reason
        await sys.until(lambda: NodeState.LOAD_FAILED in sys.node_states("/bad"))
    (failed,) = sys.node_events("/bad", NodeState.LOAD_FAILED)
    assert "after 25 s" in failed.reason
    assert sys.launcher.probes[0][1].stopped_with == ["kill"]
    assert "/bad: its library has been loading in a scratch process" in caplog.text


async def test_a_stop_ends_the_scratch_process() -> None:
    fakes = FakeLauncher(makers={"/c": [Dies]}, on_probe=hangs)
    async with running(system(container("c", "bad", "b")), fakes) as sys:
        await sys.until_loaded(1)
    assert sys.launcher.probes[0][1].stopped_with == ["kill"]
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 3


async def test_a_restart_amid_a_probe_loads_the_node_with_the_next_process() -> None:
    fakes = FakeLauncher(makers={"/c": [Dies, FakeContainer]}, on_probe=hangs)
    config = replace(container("c", "bad", "b"), probe_timeout=1000.0)
    async with running(system(config), fakes) as sys:
        await sys.until(lambda: "bad" in probed(sys))
        await sys.until_state("/c", ContainerState.RUNNING)
        sys.operated.restart("/c", "try it")
        await sys.until_loaded(2)
        assert starts(sys) == 3


async def test_a_node_that_a_person_loads_amid_its_probe_does_not_fail_by_it() -> None:
    fakes = FakeLauncher(makers={"/c": [Dies, FakeContainer]}, on_probe=hangs)
    config = replace(container("c", "bad", "b"), probe_timeout=25.0)
    async with running(system(config), fakes) as sys:
        await sys.until(lambda: "bad" in probed(sys))
        await sys.until_state("/c", ContainerState.RUNNING)
        sys.operated.start(NodeKey("/c", "/bad"))
        await sys.until_loaded(2)
        await asyncio.sleep(60)
        events = [each.kind for each in sys.events if isinstance(each, ComponentEvent)]
        assert ComponentEventKind.LOAD_FAILED not in events


async def test_of_what_a_library_writes_a_bounded_part_is_kept() -> None:
    def chatters(name: str, process: FakeProcess, on_output: OutputCallback) -> None:
        for number in range(1000):
            on_output(Stream.STDOUT, [Line(f"{number} {'x' * 1000}")])
        kept.append(sum(map(len, inspect.getclosurevars(on_output).nonlocals["stdout"])))
        poison(name, process, on_output)

    kept: list[int] = []

    fakes = FakeLauncher(makers={"/c": [Dies]}, on_probe=chatters)
    async with running(system(container("c", "bad")), fakes) as sys:
        await sys.until(lambda: NodeState.LOAD_FAILED in sys.node_states("/bad"))
    assert 0 < max(kept) < 200_000


async def test_what_it_writes_is_recorded_as_the_container_s() -> None:
    def talks(name: str, process: FakeProcess, on_output: OutputCallback) -> None:
        on_output(Stream.STDERR, [Line("about to die")])
        poison(name, process, on_output)

    fakes = FakeLauncher(makers={"/c": [Dies]}, on_probe=talks)
    async with running(system(container("c", "bad")), fakes) as sys:
        await sys.until(lambda: NodeState.LOAD_FAILED in sys.node_states("/bad"))
    lines = [each for each in sys.events if isinstance(each, OutputLine)]
    assert [(line.process, line.text) for line in lines] == [("/c", "about to die")]
    assert lines[0].pid == sys.launcher.probes[0][1].pid


async def test_a_scratch_process_that_cannot_be_started_clears_its_nodes() -> None:
    fakes = FakeLauncher(makers={"/c": [Dies, FakeContainer]})
    fakes.failures["probe"] = StartError("no memory", permanent=False)
    async with running(system(container("c", "bad", "b")), fakes) as sys:
        await sys.until_loaded(2)


async def test_a_freeze_while_loading_counts_as_a_death() -> None:
    class Freezes(Dies):
        def on_load(self, load: Load) -> None:
            if load.node_name == "bad":
                self.take(load)
                self.frozen = True
            else:
                super().on_load(load)

        frozen = False

        def on_watch(self, query: Query) -> None:
            if not self.frozen:
                super().on_watch(query)

    fakes = FakeLauncher(makers={"/c": [Freezes]}, on_probe=poison)
    async with running(system(container("c", "a", "bad")), fakes) as sys:
        await sys.until(lambda: NodeState.LOAD_FAILED in sys.node_states("/bad"))
        await sys.until_loaded(1)
        assert starts(sys) == 2


async def test_a_death_without_a_load_makes_no_suspect() -> None:
    async with running(system(container("c", "a")), FakeLauncher()) as sys:
        await sys.until_loaded(1)
        sys.launcher.containers["/c"][0].crash()
        await sys.until_state("/c", ContainerState.BACKOFF)
        await sys.until_loaded(1)
    assert not sys.launcher.probes


async def test_stock_containers_are_left_as_they_are() -> None:
    fakes = FakeLauncher(makers={"/c": [Dies, FakeContainer]}, on_probe=poison)
    config = replace(container("c", "bad"), container_type=ContainerType.STOCK)
    async with running(system(config), fakes) as sys:
        await sys.until_loaded(1)
    assert not sys.launcher.probes


async def test_so_many_are_probed_at_the_same_time_and_no_more() -> None:
    alive: list[FakeProcess] = []
    most = 0

    def slow(name: str, process: FakeProcess, on_output: OutputCallback) -> None:
        nonlocal most
        alive.append(process)
        most = max(most, len(alive))

        def end() -> None:
            alive.remove(process)
            found(process, on_output)

        asyncio.get_running_loop().call_later(1.0, end)

    config = container("c", *"abcdefgh")
    async with running(system(config), FakeLauncher(on_probe=slow)) as sys:
        await sys.until_loaded(8)
        sys.operated.probe_slots = anyio.Semaphore(3)
        probes = (probe_library(sys.operated, config, each) for each in config.composable_nodes)
        results = await asyncio.gather(*probes)
    assert all(each is not None and each.loads for each in results)
    assert most == 3


async def test_nodes_of_a_container_that_gave_up_are_not_probed() -> None:
    fakes = FakeLauncher(makers={"/c": [Dies]}, on_probe=poison)
    async with running(system(container("c", "bad", max_restarts=0)), fakes) as sys:
        await sys.until_state("/c", ContainerState.GAVE_UP)
    assert not sys.launcher.probes
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 1
