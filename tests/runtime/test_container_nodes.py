from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from msgspec.structs import replace

from play_launch.container.messages import (
    Accepted,
    Load,
    NodeStatus,
    Query,
    Rejected,
    Status,
)
from play_launch.supervisor.events import ComponentEvent, ComponentEventKind, NodeState

from .fakes import FakeContainer, FakeLauncher, Held, container, system
from .running import running

if TYPE_CHECKING:
    import pytest


def launcher(*makers: type[FakeContainer]) -> FakeLauncher:
    return FakeLauncher(makers={"/c": list(makers)} if makers else {})


def loads(fake: FakeContainer) -> list[Load]:
    return [message for message in fake.link.sent if isinstance(message, Load)]


class Silent(FakeContainer):
    """Accepts and never says a word about it again."""

    def construct(self, held: Held) -> None:
        pass


async def test_all_nodes_are_asked_for_at_once_in_order() -> None:
    async with running(system(container("c", "a", "b")), launcher(Silent)) as sys:
        await sys.until(lambda: bool(sys.node_events("/b", NodeState.LOADING)))
        fake = sys.launcher.containers["/c"][0]
        assert [load.node_name for load in loads(fake)] == ["a", "b"]
        assert [load.attempt for load in loads(fake)] == [1, 2]


async def test_silence_is_asked_about_and_the_answer_confirms() -> None:
    class ForgetsToTell(FakeContainer):
        def construct(self, held: Held) -> None:
            held.loaded = True

    async with running(system(container("c", "a", "b")), launcher(ForgetsToTell)) as sys:
        await sys.until_loaded(2)
    queries = [m for m in sys.launcher.containers["/c"][0].link.sent if isinstance(m, Query)]
    assert [query.unique_ids for query in queries] == [(1, 2)]
    confirmed = [e for e in sys.events if isinstance(e, ComponentEvent) and e.confirmed_by]
    assert [event.kind for event in confirmed] == [ComponentEventKind.LOADED] * 2


async def test_a_node_that_ignores_its_name_is_loaded_and_says_so() -> None:
    class NamedByItself(FakeContainer):
        def name_of(self, held: Held) -> str:
            return "/c" if held.load.node_name == "a" else super().name_of(held)

    declared = system(container("c", "a", "b"))
    async with running(declared, launcher(NamedByItself)) as sys:
        await sys.until_loaded(2)
        a, b = (sys.node_events(name, NodeState.LOADED)[-1].reason for name in ("/a", "/b"))
        assert (a, b) == ("it calls itself /c", "")


async def test_a_contradiction_is_asked_about() -> None:
    class Contradicts(FakeContainer):
        def construct(self, held: Held) -> None:
            super().construct(held)
            self.say(ComponentEventKind.LOAD_FAILED, held, error="or not?")

    async with running(system(container("c", "a"), duration=5.0), launcher(Contradicts)) as sys:
        await sys.stop.requested.wait()
    assert any(isinstance(m, Query) for m in sys.launcher.containers["/c"][0].link.sent)
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0


async def test_a_slow_constructor_is_reported_and_never_sent_anew(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with running(system(container("c", "a"), duration=60.0), launcher(Silent)) as sys:
        await sys.stop.requested.wait()
    assert len(loads(sys.launcher.containers["/c"][0])) == 1
    assert "has not answered" not in caplog.text
    reports = sys.node_events("/a", NodeState.LOADING)[1:]
    assert [round(report.elapsed_ns / 1e9) for report in reports] == [10, 25, 40, 55]
    pid = sys.launcher.containers["/c"][0].process.pid
    assert f"in pid {pid}, 3.0 s of it on CPU" in reports[0].reason
    assert {(report.pid, report.cpu_time_ns) for report in reports} == {(pid, 3_000_000_000)}
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 3


async def test_a_load_that_it_does_not_know_is_sent_anew_once() -> None:
    class Amnesiac(FakeContainer):
        def on_load(self, load: Load) -> None:
            self.link.say(Accepted(attempt=load.attempt, unique_id=load.attempt))

    async with running(system(container("c", "a")), launcher(Amnesiac)) as sys:
        await sys.until(lambda: bool(sys.node_events("/a", NodeState.LOAD_FAILED)))
    assert [load.attempt for load in loads(sys.launcher.containers["/c"][0])] == [1, 2]
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 1


async def test_a_request_that_got_lost_is_sent_anew() -> None:
    class LosesFirst(FakeContainer):
        def on_load(self, load: Load) -> None:
            if load.attempt > 1:
                super().on_load(load)

    async with running(system(container("c", "a")), launcher(LosesFirst)) as sys:
        await sys.until_loaded(1)
        query = next(m for m in sys.launcher.containers["/c"][0].link.sent if isinstance(m, Query))
        assert query.unique_ids == (), "without a unique_id only all can be asked about"


async def test_unanswered_queries_are_reported_and_repeated(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class AnswersThird(Silent):
        def on_query(self, query: Query) -> None:
            if query.query_id == 3:
                next(iter(self.held.values())).loaded = True
                super().on_query(query)

    async with running(system(container("c", "a")), launcher(AnswersThird)) as sys:
        await sys.until_loaded(1)
    assert "has not answered 2 question(s)" in caplog.text


async def test_a_second_acceptance_changes_nothing() -> None:
    class AcceptsTwice(FakeContainer):
        def take(self, load: Load) -> Held:
            held = super().take(load)
            self.link.say(
                Accepted(attempt=load.attempt, unique_id=held.unique_id),
                Accepted(attempt=load.attempt, unique_id=99),
            )
            return held

    async with running(system(container("c", "a")), launcher(AcceptsTwice)) as sys:
        await sys.until_loaded(1)
    assert sys.node_states("/a").count(NodeState.LOADING) == 1
    assert sys.node_events("/a", NodeState.LOADED)[0].unique_id == 1


async def test_events_of_unknown_attempts_are_recorded_and_do_nothing() -> None:
    class Confused(FakeContainer):
        def construct(self, held: Held) -> None:
            for attempt in (0, 77):
                stranger = Held(Load(attempt=attempt, package_name="", plugin_name=""), 50)
                self.say(ComponentEventKind.CRASHED, stranger, signal=11)
            self.link.say(Status(query_id=500), Rejected(attempt=0, unique_id=9, reason="what?"))
            super().construct(held)

    async with running(system(container("c", "a")), launcher(Confused)) as sys:
        await sys.until_loaded(1)
    assert NodeState.CRASHED not in sys.node_states("/a")
    crashes = [e for e in sys.events if getattr(e, "kind", None) is ComponentEventKind.CRASHED]
    assert len(crashes) == 2


async def test_a_lie_in_the_status_does_not_load_a_node_twice() -> None:
    class Liar(Silent):
        def on_query(self, query: Query) -> None:
            held = next(iter(self.held.values()))
            other = Held(Load(attempt=4711, package_name="", plugin_name=""), held.unique_id)
            self.link.say(Status(query_id=query.query_id, nodes=(self.status(other),)))

    async with running(system(container("c", "a"), duration=100.0), launcher(Liar)) as sys:
        await sys.stop.requested.wait()
    assert len(loads(sys.launcher.containers["/c"][0])) == 1
    assert NodeState.LOADED not in sys.node_states("/a")


async def test_a_rejected_load_fails_with_its_reason() -> None:
    class Rejects(FakeContainer):
        def on_load(self, load: Load) -> None:
            self.link.say(Rejected(attempt=load.attempt, unique_id=0, reason="no such plugin"))

    async with running(system(container("c", "a")), launcher(Rejects)) as sys:
        await sys.until(lambda: bool(sys.view.failed))
    assert sys.view.failed[0].reason == "no such plugin"
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 1


async def test_a_node_that_waits_for_the_loader_is_waited_for_and_the_reason_is_reported() -> None:
    note = "waits for the dynamic loader, which is opening /x/libslow.so"

    class Waits(FakeContainer):
        def construct(self, held: Held) -> None:
            asyncio.get_running_loop().call_later(100.0, super().construct, held)

        def status(self, held: Held) -> NodeStatus:
            return replace(super().status(held), note="" if held.loaded else note)

    async with running(system(container("c", "a", "b")), launcher(Waits)) as sys:
        await sys.until_loaded(2)
    assert len(sys.launcher.containers["/c"]) == 1
    assert len(loads(sys.launcher.containers["/c"][0])) == 2
    assert f"{note} (10.0 s so far)" in sys.node_events("/a", NodeState.LOADING)[1].reason
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0
