"""A container that lives and does not answer is killed and started again."""

from __future__ import annotations

import asyncio

import pytest
from msgspec.structs import replace

from play_launch.config.model import ContainerType
from play_launch.config.node_key import NodeKey
from play_launch.container.messages import Hello, Query, Status
from play_launch.control.event_words import words_of
from play_launch.process.processor_wait import ProcessorWait
from play_launch.runtime import watchdog
from play_launch.runtime.system import System
from play_launch.runtime.watchdog import INTERVAL, TIMEOUT, WANT
from play_launch.supervisor.events import ContainerState, NodeState, ProcessEvent, ProcessEventKind
from play_launch.supervisor.inputs import HealthReported, Input
from play_launch.supervisor.outcome import Cause

from .fakes import FakeContainer, FakeLauncher, Held, container, system
from .jumping_loop import run
from .running import running


class Freezes(FakeContainer):
    """Answers three times."""

    answers = 3
    asked_after_that = 0

    def on_watch(self, query: Query) -> None:
        if self.answers:
            self.answers -= 1
            super().on_watch(query)
        else:
            self.asked_after_that += 1


def launcher(*makers: type[FakeContainer]) -> FakeLauncher:
    return FakeLauncher(makers={"/c": list(makers)})


async def test_it_is_found_killed_and_started_again_with_its_nodes(
    caplog: pytest.LogCaptureFixture,
) -> None:
    fakes = launcher(Freezes, FakeContainer)
    async with running(system(container("c", "a", "b")), fakes) as sys:
        await sys.until_loaded(2)
        began = asyncio.get_running_loop().time()
        await sys.until_state("/c", ContainerState.BACKOFF)
        took = asyncio.get_running_loop().time() - began
        assert abs(took - (4 * INTERVAL + TIMEOUT)) < 0.1
        await sys.until_loaded(2)
    first = sys.launcher.containers["/c"][0]
    assert isinstance(first, Freezes)
    assert first.asked_after_that == 1, "nothing may pile up at it"
    assert first.process.stopped_with == ["kill"]
    chain = [e for e in sys.events if isinstance(e, ProcessEvent) and e.name == "/c"]
    assert [event.kind for event in chain] == [
        ProcessEventKind.STARTED,
        ProcessEventKind.READY,
        ProcessEventKind.STOPPING,
        ProcessEventKind.EXITED,
        ProcessEventKind.RESTARTING,
        ProcessEventKind.STARTED,
        ProcessEventKind.READY,
        ProcessEventKind.STOPPING,
        ProcessEventKind.EXITED,
    ]
    assert all("it is frozen: no answer for 3 s" in event.message for event in chain[2:5])
    assert "it is frozen" in sys.node_events("/a", NodeState.LOST)[0].reason
    assert "/c is killed: it is frozen" in caplog.text
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0


async def test_a_debugger_may_take_any_time() -> None:
    class Stopped(Freezes):
        answers = 0

        def start(self) -> None:
            asyncio.get_running_loop().call_later(300, super().start)

    config = replace(container("c", "a"), prefix=("gdb", "--args"))
    async with running(system(config), launcher(Stopped)) as sys:
        await sys.until_loaded(1)
        await asyncio.sleep(3600)
        assert len(sys.launcher.containers["/c"]) == 1
        assert sys.view.loaded == 1


async def test_a_container_that_answers_is_never_killed() -> None:
    class Slow(FakeContainer):
        def on_watch(self, query: Query) -> None:
            loop = asyncio.get_running_loop()
            loop.call_later(TIMEOUT - 0.1, super().on_watch, query)

    async with running(system(container("c", "a")), launcher(Slow)) as sys:
        await sys.until_loaded(1)
        await asyncio.sleep(1000)
        assert len(sys.launcher.containers["/c"]) == 1


@pytest.mark.parametrize("whose", ["ours", "theirs", "theirs, not over"])
def test_where_processors_are_short_silence_means_nothing(
    whose: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class Starved(FakeContainer):
        """Answers the third question after 20 s."""

        asked = 0

        def on_watch(self, query: Query) -> None:
            self.asked += 1
            late = 20.0 if self.asked == 3 else 0.0
            asyncio.get_running_loop().call_later(late, super().on_watch, query)

    waited = 0.0

    def waits(pid: int) -> tuple[ProcessorWait, ProcessorWait]:
        nonlocal waited
        waited += WANT * 1.01
        return (
            ProcessorWait(waited if whose == "ours" else 0.0, wants_one=False),
            ProcessorWait(waited if whose == "theirs" else 0.0, wants_one="not" in whose),
        )

    async def main() -> None:
        async with running(system(container("c", "a")), launcher(Starved)) as sys:
            await sys.until_loaded(1)
            monkeypatch.setattr(watchdog, "waits", waits)
            await asyncio.sleep(100)
            (only,) = sys.launcher.containers["/c"]
            assert isinstance(only, Starved)
            assert only.asked > 50
            assert sys.view.loaded == 1

    with caplog.at_level("INFO"):
        run(main())
    assert "/c does not answer yet; processors are short" in caplog.text


async def test_silence_while_it_stops_is_nothing_to_the_watch() -> None:
    class SlowEnd(Freezes):
        def on_shutdown(self) -> None:
            pass

    async with running(system(container("c", "a")), launcher(SlowEnd)) as sys:
        await sys.until_loaded(1)
    assert sys.launcher.containers["/c"][0].process.stopped_with == ["ask", "SIGINT"]


async def test_what_it_counts_is_told_when_it_grows(caplog: pytest.LogCaptureFixture) -> None:
    class Leaks(FakeContainer):
        def on_watch(self, query: Query) -> None:
            self.link.say(Status(query_id=query.query_id, crashes=5, leaked=1, unquiesced=2))

    async with running(system(container("c", "a")), launcher(Leaks)) as sys:
        await sys.until_loaded(1)
        await asyncio.sleep(10)
    messages = [record.getMessage() for record in caplog.records]
    assert sum("what 1 of 5 crashed nodes held stays" in each for each in messages) == 1
    assert sum("2 of 5 crashed nodes were killed" in each for each in messages) == 1


def test_answers_without_news_are_no_inputs(monkeypatch: pytest.MonkeyPatch) -> None:
    posted: list[Input] = []
    post = System.post

    def spied(system: System, said: Input) -> None:
        posted.append(said)
        post(system, said)

    monkeypatch.setattr(System, "post", spied)

    async def main() -> int:
        async with running(system(container("c", "a")), launcher(FakeContainer)) as sys:
            await sys.until_loaded(1)
            await asyncio.sleep(60)
            return len([each for each in posted if isinstance(each, HealthReported)])

    assert run(main()) == 1


@pytest.mark.parametrize("follows", ["crash", "operator"])
@pytest.mark.parametrize(
    ("unquiesced", "leaked", "found_after"), [(0, 0, None), (0, 1, None), (1, 0, 10), (1, 1, 4)]
)
async def test_a_reload_that_hangs_after_a_sudden_death_is_a_lock_that_stays_locked(
    unquiesced: int, leaked: int, found_after: float | None, follows: str
) -> None:
    class Poisoned(FakeContainer):
        def construct(self, held: Held) -> None:
            if held.load.attempt <= 2:
                super().construct(held)

        def on_watch(self, query: Query) -> None:
            answer = Status(query_id=query.query_id, unquiesced=unquiesced, leaked=leaked)
            self.link.say(answer)

    config = system(container("c", "a", "b"))
    async with running(config, launcher(Poisoned, FakeContainer)) as sys:
        await sys.until_loaded(2)
        if follows == "crash":
            sys.launcher.containers["/c"][0].crash_node("a", signal=9)
        else:
            sys.operated.restart(NodeKey("/c", "/a"))
        died = asyncio.get_running_loop().time()
        if found_after is None:
            await asyncio.sleep(60)
            assert len(sys.launcher.containers["/c"]) == 1
            return
        await sys.until_state("/c", ContainerState.BACKOFF)
        assert asyncio.get_running_loop().time() - died <= found_after
        await sys.until_loaded(2)
        (killed,) = sys.container_events("/c", ContainerState.BACKOFF)
        assert "/a is not loaded again" in killed.reason


@pytest.mark.parametrize(
    ("locks", "reason"),
    [
        (
            ("thread 12 waits", "thread 13 waits"),
            "a node died with a lock: thread 12 waits (and 1 more)",
        ),
        (("/a has been taking",), "the middleware hangs: /a has been taking"),
    ],
)
async def test_what_never_goes_on_is_cured_by_a_restart(
    locks: tuple[str, ...], reason: str
) -> None:
    class Stuck(FakeContainer):
        def on_watch(self, query: Query) -> None:
            self.link.say(Status(query_id=query.query_id, dead_locks=locks))

    fakes = launcher(Stuck, FakeContainer)
    async with running(system(container("c", "a", "b")), fakes) as sys:
        await sys.until_loaded(2)
        await sys.until_state("/c", ContainerState.BACKOFF)
        await sys.until_loaded(2)
        # The answers of the new process count anew.
        await asyncio.sleep(60)
        assert len(sys.launcher.containers["/c"]) == 2
    assert sys.launcher.containers["/c"][0].process.stopped_with == ["kill"]
    (killed,) = sys.container_events("/c", ContainerState.BACKOFF)
    assert reason in killed.reason


async def test_a_node_that_stays_in_its_callbacks_is_told_once_and_left_alone(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Busy(FakeContainer):
        busy_since: float | None = None

        def on_watch(self, query: Query) -> None:
            nodes = []
            if self.busy_since is not None:
                silence = asyncio.get_running_loop().time() - self.busy_since
                held = next(iter(self.held.values()))
                nodes = [replace(self.status(held), silence_ns=round(silence * 1e9))]
            self.link.say(Status(query_id=query.query_id, nodes=tuple(nodes)))

    async with running(system(container("c", "a", "b")), launcher(Busy)) as sys:
        await sys.until_loaded(2)
        fake = sys.launcher.containers["/c"][0]
        assert isinstance(fake, Busy)
        for _ in range(2):
            fake.busy_since = asyncio.get_running_loop().time()
            await asyncio.sleep(60)
            assert (
                "blocked in a callback"
                in sys.view.containers["/c"].nodes[NodeKey("/c", "/a")].reason
            )
            fake.busy_since = None
            await asyncio.sleep(10)
            node = sys.view.containers["/c"].nodes[NodeKey("/c", "/a")]
            assert node.reason == "its executor was blocked in a callback for 60 s, and goes on"
            assert node.cause is Cause.RETURNED
            assert words_of(node).text == f"/a: {node.reason}"
            assert node.elapsed_ns == 0, "the load took no time"
        fake.busy_since = asyncio.get_running_loop().time()
        await asyncio.sleep(60.3)  # the reload is over before the next answer
        fake.busy_since = None
        fake.crash_node("a")
        await asyncio.sleep(60)
        node = sys.view.containers["/c"].nodes[NodeKey("/c", "/a")]
        assert (node.state, node.cause, node.reason) == (NodeState.LOADED, Cause.NONE, "")
        assert len(sys.launcher.containers["/c"]) == 1
    warnings = [r.getMessage() for r in caplog.records if "blocked in a callback" in r.getMessage()]
    assert len(warnings) == 3
    assert all("/a: its executor has been blocked in a callback for 1" in each for each in warnings)
    assert all(not event.reason for event in sys.node_events("/b", NodeState.LOADED))


async def test_a_storm_of_deaths_is_told_when_it_begins_and_when_it_is_over(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Storm(FakeContainer):
        deaths = 0

        def on_watch(self, query: Query) -> None:
            self.deaths = min(self.deaths + 7, 70)
            answer = Status(query_id=query.query_id, crashes=self.deaths, unquiesced=self.deaths)
            self.link.say(answer)

    async with running(system(container("c", "a")), launcher(Storm)) as sys:
        await sys.until_loaded(1)
        await asyncio.sleep(120)
    told = [
        r.getMessage()
        for r in caplog.records
        if "locks they held may remain locked" in r.getMessage()
    ]
    assert [each.split()[1] for each in told] == ["7", "70"]


async def test_a_crash_whose_frame_was_dropped_is_found_with_the_next_answer(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Drops(FakeContainer):
        dropped = 0

        def on_watch(self, query: Query) -> None:
            answer = Status(query_id=query.query_id, dropped_frames=self.dropped)
            self.link.say(answer)

    async with running(system(container("c", "a", "b")), launcher(Drops)) as sys:
        await sys.until_loaded(2)
        (fake,) = sys.launcher.containers["/c"]
        assert isinstance(fake, Drops)
        del fake.held[1]
        fake.dropped = 1
        await sys.until_loaded(1)
        await asyncio.sleep(60)
        assert sum(isinstance(each, Query) for each in fake.link.sent) == 1
    assert "does not know it" in sys.node_events("/a", NodeState.LOST)[0].reason
    assert NodeState.LOST not in sys.node_states("/b")
    assert caplog.text.count("/c has dropped 1 frames so far") == 1


async def test_how_nodes_are_isolated_is_told(caplog: pytest.LogCaptureFixture) -> None:
    class FallsBack(FakeContainer):
        def hello(self, protocol_version: int = 1) -> Hello:
            return replace(
                super().hello(protocol_version),
                mode="isolated",
                mechanism="process",
                notes=("Linux 5.10 is older than 5.16",),
            )

    members = [
        replace(container(name, "a"), container_type=ContainerType.ISOLATED) for name in ("c", "d")
    ]
    fakes = FakeLauncher(makers={"/c": [FallsBack], "/d": [FallsBack]})
    async with running(system(*members), fakes) as sys:
        await sys.until_loaded(2)
        assert sys.view.containers["/c"].mechanism == "process"
    assert sys.view.containers["/c"].mechanism == ""
    ready = next(
        event
        for event in sys.events
        if isinstance(event, ProcessEvent) and event.kind is ProcessEventKind.READY
    )
    assert ready.message.startswith("isolated by process, ")
    assert ready.message.endswith("; Linux 5.10 is older than 5.16")
    assert caplog.text.count("isolated by process, not by shared_memory") == 1
