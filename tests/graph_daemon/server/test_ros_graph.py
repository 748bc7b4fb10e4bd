"""The node that looks at the graph, among real nodes."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator

import pytest

from play_launch.graph_daemon.contract import GRAPH_METHODS
from play_launch.graph_daemon.server import ros_graph
from play_launch.graph_daemon.server.replacement import Replacer
from play_launch.graph_daemon.server.ros_graph import RosGraph, graph_functions, rmw_implementation
from play_launch.graph_daemon.server.service import GraphService
from play_launch.ros.graph_guard import GraphGuardError
from play_launch.ros.waiting import Waiting
from tests.support.ros import Probe
from tests.support.waiting import LIMIT, until


class Changes:
    """Counts reports of changes."""

    def __init__(self) -> None:
        self.count = 0
        self.event = threading.Event()

    def __call__(self) -> None:
        self.count += 1
        self.event.set()


@pytest.fixture
def changes() -> Changes:
    return Changes()


@pytest.fixture
def graph(ros_domain: int, changes: Changes) -> Iterator[RosGraph]:
    made = RosGraph(ros_domain, changes)
    yield made
    made.close()


def test_it_is_named_like_the_node_of_ros2clis_daemon(graph: RosGraph, ros_domain: int) -> None:
    assert graph.name.startswith(f"_ros2cli_daemon_{ros_domain}_")
    assert len(graph.name.rpartition("_")[2]) == 32
    assert (graph.name, "/") in graph.nodes()
    assert rmw_implementation().startswith("rmw_")


def test_a_change_is_reported_without_asking(graph: RosGraph, changes: Changes) -> None:
    until(lambda: changes.count > 0, "the graph's own appearance")
    changes.event.clear()
    with Probe("newcomer"):
        assert changes.event.wait(LIMIT)
        until(lambda: ("newcomer", "/") in graph.nodes(), "the newcomer")
        changes.event.clear()
    assert changes.event.wait(LIMIT)


def test_participants_are_met_with_their_nodes(graph: RosGraph) -> None:
    # Others may be in this domain, by tests of other modules that have just ended.
    before = graph.met().participants
    assert before >= 1
    with Probe("newcomer"):
        until(lambda: graph.met().participants > before, "another participant")
        until(lambda: graph.met().nameless == 0, "its node")


def test_every_method_has_a_function_with_a_text(graph: RosGraph) -> None:
    functions = graph_functions(lambda: graph)
    assert tuple(functions) == GRAPH_METHODS
    assert all(function.__doc__ for function in functions.values())
    assert functions["get_name"]() == graph.name


def test_where_changes_are_not_reported_it_is_looked_all_the_time(
    ros_domain: int, changes: Changes, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: object) -> bool:
        raise GraphGuardError("by the test")

    monkeypatch.setattr(Waiting, "wait", broken)
    monkeypatch.setattr(ros_graph, "_LOOK", 0.01)
    made = RosGraph(ros_domain, changes)
    until(lambda: changes.count > 3, "some looks")
    made.close()


def test_a_real_replacement_never_shows_fewer_nodes(ros_domain: int) -> None:
    names = {f"member_{number}" for number in range(4)}

    async def scenario() -> None:
        service = GraphService(
            graph_functions(lambda: service.graph),
            participants_here=lambda: 0,
            status=str,
            shutdown=lambda: None,
        )

        def build() -> RosGraph:
            return RosGraph(ros_domain, service.changed)

        def members() -> set[str]:
            return {name for name, _ in service.graph.nodes()} & names

        async def wait_for(done: Callable[[], bool]) -> None:
            while not done():
                await asyncio.sleep(0.02)

        old = build()
        service.use(old)
        await wait_for(lambda: members() == names)
        replacer = Replacer(service, build)
        task = asyncio.create_task(replacer.run())
        replacer.request()
        while replacer.replacements == 0:
            assert members() == names
            await asyncio.sleep(0.01)
        assert members() == names
        assert service.graph is not old
        new = service.graph
        # The old one leaves.
        await wait_for(lambda: old.name not in {name for name, _ in new.nodes()})
        assert members() == names
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        service.close()
        await asyncio.to_thread(new.close)

    probes = [Probe(name) for name in names]
    asyncio.run(asyncio.wait_for(scenario(), 2 * LIMIT))
    for probe in probes:
        probe.__exit__(None, None, None)
