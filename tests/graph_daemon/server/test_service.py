"""When requests are answered, and from which state of the graph."""

from __future__ import annotations

import asyncio
import sys
import threading
from collections.abc import Awaitable, Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.graph_daemon.server.reply_cache import ReplyCache
from play_launch.graph_daemon.server.service import LONGEST_COUNT, GraphService
from play_launch.graph_daemon.server.warm_up import Population
from tests.graph_daemon.server.graphs import FakeGraph
from tests.graph_daemon.wire import read, request_body

WAIT = 60.0
NODES = request_body("get_node_names_and_namespaces", [])
METHODS = ("get_node_names_and_namespaces", "get_topic_names_and_types", "get_name")


class Service(GraphService):
    """A service on made-up graphs; answers do not outlive a change unless the cache says so."""

    def __init__(
        self, here: Callable[[], int] = lambda: 1, cache: ReplyCache | None = None
    ) -> None:
        self.ended = 0
        self.answering: set[asyncio.Task[bytes]] = set()

        def functions() -> dict[str, Callable[..., object]]:
            def of(method: str) -> Callable[..., object]:
                return lambda *arguments: self.graph.call(method, *arguments)

            return {method: of(method) for method in METHODS}

        def end() -> None:
            self.ended += 1

        super().__init__(
            functions(),
            participants_here=here,
            status=lambda: "the status",
            shutdown=end,
            cache=cache or ReplyCache(hold=0.0),
        )

    def ask(self, body: bytes) -> list[object]:
        """Ask; returns a list that the answer is put into: now, or when the service has it."""
        answers: list[object] = []
        answering = self.answer(body)
        try:
            answering.send(None)
        except StopIteration as done:
            answers.append(read(done.value))
            return answers
        # It waits.
        answering.close()
        task = asyncio.get_running_loop().create_task(self.answer(body))
        self.answering.add(task)
        task.add_done_callback(lambda done: answers.append(read(done.result())))
        return answers


def run(scenario: Callable[[], Awaitable[None]]) -> None:
    async def limited() -> None:
        await asyncio.wait_for(scenario(), WAIT)

    asyncio.run(limited())


async def answered(answers: list[object]) -> list[object]:
    while not answers:
        await asyncio.sleep(0)
    return answers


def test_requests_about_the_graph_wait_until_it_is_quiet() -> None:
    async def scenario() -> None:
        service, graph = Service(), FakeGraph()
        service.use(graph)
        waiting = service.ask(NODES)
        assert service.ask(request_body("system.play_launch_status", [])) == ["the status"]
        assert service.ask(request_body("system.listMethods", [])) != []
        assert service.ask(request_body("unknown", [])) != []
        assert waiting == []
        assert not service.is_warm
        graph.known.add("talker")
        await service.wait_warm()
        assert await answered(waiting) == [[["daemon", "/"], ["talker", "/"]]]
        assert service.ask(NODES) == waiting

    run(scenario)


def test_it_is_not_warm_while_a_participant_is_missing() -> None:
    async def scenario() -> None:
        service, graph = Service(here=lambda: 3), FakeGraph()
        graph.participants = 2
        service.use(graph)
        waiting = service.ask(NODES)
        await asyncio.sleep(0.8)
        assert waiting == []
        graph.participants = 3
        await service.wait_warm()
        await answered(waiting)

    run(scenario)


def test_it_gets_warm_although_a_participant_stays_away() -> None:
    async def scenario() -> None:
        service = Service(here=lambda: 3)
        service.use(FakeGraph())
        await service.wait_warm()
        assert service.ask(NODES) != []

    run(scenario)


@pytest.mark.parametrize("failures", [1, sys.maxsize])
def test_it_gets_warm_although_looking_fails(
    failures: int, caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario() -> None:
        service, graph = Service(), FakeGraph()
        met = graph.met
        left = failures

        def fails_at_first() -> tuple[int, int]:
            nonlocal left
            left -= 1
            if left >= 0:
                raise RuntimeError("by the test")
            return met()

        graph.met = fails_at_first  # type: ignore[method-assign]
        service.use(graph)
        waiting = service.ask(NODES)
        await service.wait_warm()
        await answered(waiting)

    run(scenario)
    # Once, however often it fails.
    assert caplog.text.count("RuntimeError: by the test") == 1


def test_the_graph_is_asked_once_for_each_change() -> None:
    async def scenario() -> None:
        service, graph = Service(), FakeGraph()
        service.use(graph)
        await service.wait_warm()
        for _ in range(5):
            service.ask(NODES)
        assert len(graph.calls) == 1
        assert service.cached_replies == 4
        generation = service.generation
        # From any thread, and at once: the loop does not run in between.
        thread = threading.Thread(target=service.changed)
        thread.start()
        thread.join()
        assert service.generation == generation + 1
        graph.known.add("newcomer")
        assert ["newcomer", "/"] in service.ask(NODES)[0]  # type: ignore[operator]
        assert len(graph.calls) == 2

    run(scenario)


def test_in_a_storm_an_answer_serves_more_than_one_client() -> None:
    async def scenario() -> None:
        cache = ReplyCache(longest=WAIT, hold=1e9, longest_hold=WAIT)
        service, graph = Service(cache=cache), FakeGraph()
        service.use(graph)
        await service.wait_warm()
        graph.during_call = service.changed
        for _ in range(16):
            service.ask(NODES)
            service.changed()
        assert len(graph.calls) == 1

    run(scenario)


def test_a_change_while_the_graph_is_asked_makes_the_answer_old() -> None:
    async def scenario() -> None:
        service, graph = Service(), FakeGraph()
        service.use(graph)
        await service.wait_warm()
        graph.during_call = service.changed
        service.ask(NODES)
        graph.during_call = lambda: None
        service.ask(NODES)
        service.ask(NODES)
        assert len(graph.calls) == 2

    run(scenario)


def test_a_fault_is_an_answer() -> None:
    async def scenario() -> None:
        service = Service()
        service.use(FakeGraph())
        await service.wait_warm()
        body = request_body("get_name", [1])
        text = "<class 'ValueError'>:get_name is not made up"
        assert service.ask(body) == [["fault", 1, text]]

    run(scenario)


def test_the_end_answers_who_waits_and_is_passed_on() -> None:
    async def scenario() -> None:
        service = Service()
        service.use(FakeGraph())
        waiting = service.ask(NODES)
        assert service.ask(request_body("system.shutdown", [])) == [None]
        assert service.ended == 1
        service.close()
        await answered(waiting)

    run(scenario)


def test_who_is_missing() -> None:
    assert Population(9, 3, 3, 0).is_complete
    assert not Population(9, 2, 3, 0).is_complete
    assert not Population(9, 3, 3, 1).is_complete
    # A middleware that does not show participants.
    assert Population(9, 0, 3, 0).is_complete
    # Participants of other machines.
    assert Population(9, 5, 3, 0).is_complete


@given(st.lists(st.sampled_from(["ask", "change", "wait", "join"]), max_size=40))
def test_at_rest_nobody_counts(steps: list[str]) -> None:
    """A replay asks twice a second how the graph is: that must not look at the graph each time."""

    async def scenario() -> None:
        here = 1
        service, graph = Service(here=lambda: here), FakeGraph()
        with pytest.MonkeyPatch.context() as patch:
            now = 1000.0
            patch.setattr("time.monotonic", lambda: now)
            service.use(graph)
            counted = due = 0
            met = graph.met

            def count() -> tuple[int, int]:
                nonlocal counted
                counted += 1
                return met()

            graph.met = count  # type: ignore[method-assign]
            fresh, last = False, now
            for step in steps:
                match step:
                    case "change":
                        graph.known.add(f"node{len(graph.known)}")
                        service.changed()
                        fresh = False
                    case "wait":
                        now += 0.6 * LONGEST_COUNT
                    case "join":
                        here += 1
                    case "ask":
                        if not fresh or now - last > LONGEST_COUNT:
                            due, fresh, last = due + 1, True, now
                        population = service.population()
                        assert population.nodes == len(graph.known) - 1
                        # The kernel's count is always that of now.
                        assert population.participants_here == here
                assert counted == due
        service.close()

    run(scenario)
