"""Members and nodes that wait for what they depend on."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable
from types import MappingProxyType
from typing import Any, NoReturn

import pytest
from msgspec.structs import replace

from play_launch.config.dependency import Condition, Dependency, OnTimeout, StartRule
from play_launch.config.model import OnExit, ReplayConfig
from play_launch.config.node_key import NodeKey
from play_launch.process.exit import Exit
from play_launch.ros.access import GraphSource, RosAccess, Wanted
from play_launch.runtime.launcher import StartError
from play_launch.supervisor import process_rules
from play_launch.supervisor.conditions import may_start
from play_launch.supervisor.events import (
    ComponentEventKind,
    ContainerState,
    NodeState,
    ProcessEvent,
    ProcessEventKind,
)

from .fakes import FakeContainer, FakeLauncher, Held, container, process, system
from .running import Running, running

STARTED, EXITED = ProcessEventKind.STARTED, ProcessEventKind.EXITED
GAVE_UP, WAITING = ProcessEventKind.GAVE_UP, ProcessEventKind.WAITING


def on(
    condition: Condition,
    unit: str = "",
    subject: str = "",
    timeout: float = math.inf,
    on_timeout: OnTimeout = OnTimeout.FAIL,
) -> Dependency:
    return Dependency(
        condition=condition, unit=unit, subject=subject, timeout=timeout, on_timeout=on_timeout
    )


def rules(config: ReplayConfig, delay: float = 0.0, **rule: Dependency) -> ReplayConfig:
    """The keys are names without their slash; the nodes are those of the container c."""
    found = {
        (f"/{name}" if f"/{name}" in config.units else f"/c:/{name}"): StartRule(
            dependencies=(dependency,), delay=delay
        )
        for name, dependency in rule.items()
    }
    return replace(config, start_rules=MappingProxyType(found))


def reasons(sys: Running, name: str) -> list[str]:
    return [
        event.message
        for event in sys.events
        if isinstance(event, ProcessEvent) and event.name == name and event.kind is WAITING
    ]


class Graph(GraphSource):
    def __init__(self, on_change: Callable[[Wanted], None]) -> None:
        self.on_change = on_change
        self.watched: list[frozenset[tuple[Condition, str]]] = []
        self.is_closed = False

    def watch(self, wanted: Iterable[tuple[Condition, str]]) -> None:
        self.watched.append(frozenset(wanted))

    async def close(self) -> None:
        self.is_closed = True


class Ros(RosAccess):
    def __init__(self) -> None:
        self.graphs: list[Graph] = []

    def watch_graph(self, on_change: Callable[[Wanted], None]) -> Graph:
        self.graphs.append(Graph(on_change))
        return self.graphs[-1]

    def managed_node(self, name: str, on_state: Callable[[int], None]) -> NoReturn:
        raise AssertionError(name)


async def test_a_process_waits_for_one_that_exits_with_status_0() -> None:
    fakes = FakeLauncher()
    config = rules(system(process("late"), process("early")), late=on(Condition.EXITED, "/early"))
    async with running(config, fakes) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/early"))
        await asyncio.sleep(100)
        assert "/late" not in fakes.processes
        assert sys.view.processes["/late"].message == "waits for /early to exit with status 0"
        assert not sys.view.is_complete
        fakes.processes["/early"][0].end(Exit())
        await sys.until(lambda: STARTED in sys.process_events("/late"))
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0


@pytest.mark.parametrize("how", ["exit", "start", "stop"])
async def test_one_that_cannot_come_any_more_is_reported_and_not_waited_for(how: str) -> None:
    fakes = FakeLauncher()
    if how == "start":
        fakes.failures["/early"] = StartError("no file", permanent=True)
    config = system(process("late"), process("later"), process("early"), process("other"))
    needs = on(Condition.EXITED, "/early")
    config = rules(config, late=needs, later=on(Condition.STARTED, "/late"))
    async with running(config, fakes) as sys:
        if how == "exit":
            await sys.until(lambda: STARTED in sys.process_events("/early"))
            fakes.processes["/early"][0].end(Exit(code=3))
        elif how == "stop":
            await sys.until(lambda: STARTED in sys.process_events("/early"))
            sys.operated.stop("/early", "not needed")
        await sys.until(lambda: GAVE_UP in sys.process_events("/later"))
        assert "/late" not in fakes.processes
    why = {"exit": "exited with status 3", "start": "no file", "stop": "not needed"}[how]
    assert why in sys.gave_up()["/late"]
    assert sys.gave_up()["/late"].startswith("it waited for /early to exit with status 0: ")
    assert sys.gave_up()["/later"].startswith("it waited for /late to be started: it gave up: ")
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 1


async def test_a_long_wait_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    config = rules(system(process("late"), process("early")), late=on(Condition.EXITED, "/early"))
    async with running(config, FakeLauncher()):
        await asyncio.sleep(31)
    reports = [each.message for each in caplog.records if "has waited" in each.message]
    what = "it waits for /early to exit with status 0"
    assert reports == [f"/late has waited for {n} s: {what}" for n in (15, 30)]


async def test_a_delay() -> None:
    fakes = FakeLauncher()
    config = system(process("late", on_exit=OnExit.RESTART), container("c", "n"))
    config = rules(config, delay=5.0, late=on(Condition.LOADED, "/c:/n"))
    async with running(config, fakes) as sys:
        await sys.until_loaded(1)
        began = asyncio.get_running_loop().time()
        await sys.until(lambda: STARTED in sys.process_events("/late"))
        assert abs(asyncio.get_running_loop().time() - began - 5.0) < 0.1
        began = asyncio.get_running_loop().time()
        fakes.processes["/late"][0].end(Exit())
        await sys.until(lambda: sys.process_events("/late").count(STARTED) == 2)
        assert asyncio.get_running_loop().time() - began < 1.0, "a restart waits for nothing"
    assert reasons(sys, "/late")[-1] == "waits for its delay of 5 s"


class Slow(FakeContainer):
    """Constructs when it is told to."""

    def construct(self, held: Held) -> None:
        pass

    def let_construct(self, name: str) -> None:
        (held,) = (each for each in self.held.values() if each.load.node_name == name)
        super().construct(held)


async def test_nodes_wait_for_each_other_and_a_container_is_loaded_with_its_last_one() -> None:
    fakes = FakeLauncher(makers={"/c": [Slow]})
    config = system(container("c", "b", "a"), container("d"))
    config = rules(config, b=on(Condition.LOADED, "/c:/a"), d=on(Condition.LOADED, "/c"))
    async with running(config, fakes) as sys:
        await sys.until(lambda: NodeState.LOADING in sys.node_states("/a"))
        slow = fakes.containers["/c"][0]
        assert isinstance(slow, Slow)
        await asyncio.sleep(1)
        assert sys.node_states("/b") == [NodeState.PENDING] * 2
        assert sys.node_events("/b", NodeState.PENDING)[-1].reason == "waits for /a to be loaded"
        slow.let_construct("a")
        await sys.until(lambda: NodeState.LOADING in sys.node_states("/b"))
        assert "/d" not in fakes.containers
        starting = sys.container_events("/d", ContainerState.STARTING)
        assert starting[-1].reason == "waits for /c to be loaded"
        slow.let_construct("b")
        await sys.until_state("/d", ContainerState.RUNNING)


async def test_a_node_whose_dependency_fails_to_load_fails_with_the_reason() -> None:
    class Fails(FakeContainer):
        def construct(self, held: Held) -> None:
            self.say(ComponentEventKind.LOAD_FAILED, held, error="no such class")

    fakes = FakeLauncher(makers={"/c": [Fails]})
    config = system(container("c", "b", "a"), process("p"))
    config = rules(config, b=on(Condition.LOADED, "/c:/a"), p=on(Condition.LOADED, "/c"))
    async with running(config, fakes) as sys:
        await sys.until(lambda: GAVE_UP in sys.process_events("/p"))
        await sys.until(lambda: NodeState.LOAD_FAILED in sys.node_states("/b"))
        # It starts on request all the same.
        sys.operated.start(NodeKey("/c", "/b"))
        await sys.until(lambda: NodeState.REQUESTED in sys.node_states("/b"))
    reason = sys.node_events("/b", NodeState.LOAD_FAILED)[0].reason
    assert reason == "it waited for /a to be loaded: it failed to load: no such class"


async def test_a_crash_that_is_followed_up_is_waited_for() -> None:
    fakes = FakeLauncher()
    config = system(container("c", "a"), process("p"))
    config = rules(config, delay=1.0, p=on(Condition.LOADED, "/c:/a"))
    async with running(config, fakes) as sys:
        await sys.until_loaded(1)
        fakes.containers["/c"][0].crash()
        await sys.until_state("/c", ContainerState.BACKOFF)
        await sys.until_loaded(1)
        await sys.until(lambda: STARTED in sys.process_events("/p"))


async def test_units_that_wait_can_be_started_and_stopped() -> None:
    fakes = FakeLauncher()
    config = system(process("one"), process("two"), process("early"), container("c", "n"))
    config = rules(
        config,
        one=on(Condition.EXITED, "/early"),
        two=on(Condition.EXITED, "/early"),
        n=on(Condition.EXITED, "/early"),
    )
    async with running(config, fakes) as sys:
        await sys.until(lambda: WAITING in sys.process_events("/two"))
        await sys.until_state("/c", ContainerState.RUNNING)
        sys.operated.start("/one")
        sys.operated.stop("/two", "not needed")
        sys.operated.stop(NodeKey("/c", "/n"))
        await sys.until(lambda: STARTED in sys.process_events("/one"))
        await sys.until(lambda: NodeState.UNLOADED in sys.node_states("/n"))
        fakes.processes["/early"][0].end(Exit())
        await asyncio.sleep(20)
        assert "/two" not in fakes.processes
        assert sys.node_states("/n")[-1] is NodeState.UNLOADED


async def test_lines_and_the_graph() -> None:
    fakes, ros = FakeLauncher(), Ros()
    config = system(process("early"), process("line"), process("graph"), container("c", "n"))
    config = rules(
        config,
        line=on(Condition.LOG, "/early", r"ready \d"),
        graph=on(Condition.TOPIC, subject="/scan"),
        n=on(Condition.SERVICE, subject="/map"),
    )
    async with running(config, fakes, ros=ros) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/early"))
        await sys.until_state("/c", ContainerState.RUNNING)
        await asyncio.sleep(1)
        (graph,) = ros.graphs
        scan, service = (Condition.TOPIC, "/scan"), (Condition.SERVICE, "/map")
        assert graph.watched[-1] == {scan, service}
        sys.say("/early", "not ready yet")
        graph.on_change(frozenset({service}))
        await sys.until_loaded(1)
        assert graph.watched[-1] == {scan}
        assert "/line" not in fakes.processes
        sys.say("/early", "ready 5")
        await sys.until(lambda: STARTED in sys.process_events("/line"))
        graph.on_change(frozenset({scan}))
        await sys.until(lambda: STARTED in sys.process_events("/graph"))
        assert graph.watched[-1] == frozenset()
    assert graph.is_closed


async def test_the_graph_counts_as_it_is_as_long_as_a_unit_waits_for_it() -> None:
    scan, map_ = (Condition.TOPIC, "/scan"), (Condition.SERVICE, "/map")

    fakes, ros = FakeLauncher(), Ros()
    rule = StartRule(dependencies=tuple(on(kind, subject=name) for kind, name in (scan, map_)))
    config = replace(system(process("p")), start_rules=MappingProxyType({"/p": rule}))
    more = {"/p": rule, "/late": StartRule(dependencies=rule.dependencies[:1])}
    target = system(process("p"), process("late"))
    target = replace(target, start_rules=MappingProxyType(more))
    async with running(config, fakes, ros=ros) as sys:
        await sys.until(lambda: WAITING in sys.process_events("/p"))
        (graph,) = ros.graphs
        for seen in (scan, map_):
            graph.on_change(frozenset({seen}))
            await asyncio.sleep(1)
            assert graph.watched == [{scan, map_}]
        assert "/p" not in fakes.processes
        graph.on_change(frozenset({scan, map_}))
        await sys.until(lambda: STARTED in sys.process_events("/p"))
        # What was seen before is no news of the graph as it is now.
        applying = asyncio.ensure_future(sys.operated.applying.apply(target))
        await sys.until(lambda: "/late" in sys.view.processes)
        await asyncio.sleep(1)
        assert "/late" not in fakes.processes
        graph.on_change(frozenset({scan}))
        assert (await applying).succeeded


async def test_an_exception_in_the_rules_of_one_process_is_its_failure_alone(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fails_for_one(step: Any, unit: Any) -> Any:
        if unit.name == "/p":
            raise LookupError("a bug")
        return may_start(step, unit)

    monkeypatch.setattr(process_rules, "may_start", fails_for_one)
    async with running(system(process("p"), process("early")), FakeLauncher()) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/early"))
        assert list(sys.gave_up()) == ["/p"]
    assert "LookupError: a bug" in caplog.text


async def test_one_that_ends_without_the_line_is_not_waited_for() -> None:
    fakes = FakeLauncher()
    config = rules(system(process("p"), process("early")), p=on(Condition.LOG, "/early", "x"))
    async with running(config, fakes) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/early"))
        early = fakes.processes["/early"][0]
        early.lingers = 2.0
        early.end(Exit())
        await asyncio.sleep(1)
        assert GAVE_UP not in sys.process_events("/p"), "its last lines are not read yet"
        await sys.until(lambda: GAVE_UP in sys.process_events("/p"))
    assert sys.gave_up() == {"/p": "it waited for a line of /early that matches x: it ended"}


async def test_they_stop_in_reverse_order() -> None:
    fakes = FakeLauncher()
    config = system(process("a"), container("c", "n"), process("z"), process("free"))
    config = rules(config, n=on(Condition.STARTED, "/a"), z=on(Condition.LOADED, "/c:/n"))
    async with running(config, fakes) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/z"))
    ends = [
        event.name
        for event in sys.events
        if isinstance(event, ProcessEvent)
        and event.kind in (EXITED, ProcessEventKind.STOPPING)
        and event.name != "/free"
    ]
    assert ends == ["/z", "/z", "/c", "/c", "/a", "/a"]


async def test_a_hurried_stop_ends_all_at_once() -> None:
    fakes = FakeLauncher(on_process=lambda started: started.deaf_to.add("SIGINT"))
    config = rules(system(process("a"), process("b")), b=on(Condition.STARTED, "/a"))
    async with running(config, fakes) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/b"))
        sys.stop.request(2)
        await asyncio.sleep(0.5)
        assert ProcessEventKind.STOPPING not in sys.process_events("/a")
        sys.stop.request(2)
        await asyncio.sleep(0.1)
        assert ProcessEventKind.STOPPING in sys.process_events("/a")


async def test_a_stop_while_everything_waits() -> None:
    config = system(process("a"), process("b"), container("c", "n"))
    config = rules(
        config,
        a=on(Condition.FILE, subject="/nowhere/at/all"),
        b=on(Condition.STARTED, "/a"),
        c=on(Condition.STARTED, "/b"),
    )
    async with running(config, FakeLauncher()) as sys:
        await sys.until(lambda: WAITING in sys.process_events("/b"))
    assert not sys.launcher.processes
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 3
