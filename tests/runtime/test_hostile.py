"""What a hostile operator, a full machine and errors of our own do to a running system."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, NoReturn

import pytest

from play_launch.config.dependency import Condition
from play_launch.config.model import OnExit
from play_launch.config.node_key import NodeKey
from play_launch.container.messages import Load, Rejected
from play_launch.process.exit import Exit
from play_launch.ros.access import RosAccess
from play_launch.runtime.signals import StopRequests
from play_launch.supervisor import node_rules, process_rules
from play_launch.supervisor.events import NodeState, ProcessEventKind

from .fakes import (
    FakeContainer,
    FakeLauncher,
    FakeProcess,
    Held,
    NoGroups,
    container,
    process,
    system,
)
from .running import running
from .test_order import on, rules

if TYPE_CHECKING:
    from play_launch.process.stop import StopPolicy
    from play_launch.supervisor.reducer import Reduction

STARTED = ProcessEventKind.STARTED


async def test_a_rule_that_always_raises_fails_its_unit_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settle = node_rules.settle

    def raises(step: Reduction, key: NodeKey) -> None:
        if key.name == "/a":
            raise LookupError("a bug")
        settle(step, key)

    async with running(system(container("c", "a"), container("d", "b")), FakeLauncher()) as sys:
        await sys.until_loaded(2)
        monkeypatch.setattr(node_rules, "settle", raises)
        sys.operated.stop(NodeKey("/c", "/a"))
        await asyncio.sleep(100)
        assert sys.view.containers["/d"].loaded == 1
    assert list(sys.gave_up()) == ["/c"]


async def test_a_process_rule_that_raises_for_ever_fails_its_unit_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settle = process_rules.settle

    def raises(step: Reduction, name: str) -> None:
        if name == "/p":
            raise LookupError("a bug")
        settle(step, name)

    async with running(system(container("d", "b"), process("p")), FakeLauncher()) as sys:
        await sys.until_loaded(1)
        monkeypatch.setattr(process_rules, "settle", raises)
        sys.operated.restart("/p", "x")
        await asyncio.sleep(100)
        assert sys.view.containers["/d"].loaded == 1
    assert list(sys.gave_up()) == ["/p"]


async def test_a_graph_that_cannot_be_watched_holds_up_nothing_else() -> None:
    class Broken(RosAccess):
        def __init__(self) -> None:
            pass

        def watch_graph(self, on_change: object) -> NoReturn:
            raise ImportError("no rclpy")

        def managed_node(self, name: str, on_state: object) -> NoReturn:
            raise ImportError("no rclpy")

    config = rules(
        system(container("c", "a"), process("late"), process("later")),
        late=on(Condition.TOPIC, subject="/x"),
        later=on(Condition.TOPIC, subject="/x", timeout=5.0),
    )
    async with running(config, FakeLauncher(), ros=Broken()) as sys:
        await sys.until_loaded(1)
        await sys.until(lambda: "/later" in sys.gave_up())
        sys.operated.start("/late")
        await sys.until(lambda: STARTED in sys.process_events("/late"))


async def test_what_had_not_come_as_the_end_began_is_known_after_a_crash_too() -> None:
    launcher = FakeLauncher()
    config = rules(
        system(process("late"), process("ends", on_exit=OnExit.SHUTDOWN)),
        late=on(Condition.FILE, subject="/nonexistent/file"),
    )
    async with running(config, launcher) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/ends"))
        launcher.processes["/ends"][0].end(Exit(code=1))
        await sys.until_stopped()
        assert sys.operated.pending == ("/late",)


async def test_one_that_is_stopped_while_its_process_leaves_something_is_not_pending() -> None:
    launcher = FakeLauncher(on_process=lambda each: setattr(each, "lingers", 9.0))
    config = system(process("p", on_exit=OnExit.RESTART), process("q"))
    async with running(config, launcher) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/p"))
        launcher.processes["/p"][0].end(Exit(code=1))
        await asyncio.sleep(5)
        sys.operated.stop("/p", "enough")
        await asyncio.sleep(20)
        assert len(launcher.processes["/p"]) == 1
        assert sys.view.processes["/p"].kind is not ProcessEventKind.RESTARTING
        assert sys.process_events("/p")[-1] is ProcessEventKind.STOPPED


async def test_a_node_known_only_by_the_answer_is_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Quiet(FakeContainer):
        def construct(self, held: Held) -> None:
            held.loaded = True

    async with running(system(container("c", "a")), FakeLauncher({"/c": [Quiet]})) as sys:
        await sys.until_loaded(1)
    assert "no event reported it" in caplog.text


async def test_a_rejected_load_leaves_its_group() -> None:
    left: list[int] = []

    class Groups(NoGroups):
        def leave(self, attempt: int) -> str:
            left.append(attempt)
            return ""

    class Rejects(FakeContainer):
        def on_load(self, load: Load) -> None:
            self.link.say(Rejected(attempt=load.attempt, unique_id=0, reason="no"))

    class Forgets(FakeContainer):
        def on_load(self, load: Load) -> None:
            pass

    launcher = FakeLauncher({"/c": [Rejects], "/d": [Forgets]}, groups=Groups())
    async with running(system(container("c", "a"), container("d", "b")), launcher) as sys:
        await sys.until(lambda: bool(sys.node_events("/b", NodeState.LOAD_FAILED)))
        await asyncio.sleep(1)
    assert left == [1, 3]  # the second attempt is forgotten, and sent once more


async def test_one_that_does_not_die_is_not_stopped_again_at_the_end() -> None:
    class Immortal(FakeProcess):
        def kill(self) -> None:
            self.stopped_with.append("kill")

        async def stop(
            self, policy: StopPolicy, *, ask: Callable[[], bool] | None, hurry: asyncio.Event
        ) -> bool:
            self.stopped_with.append("stop")
            await asyncio.sleep(10)
            return False

    async with running(system(process("p"), process("q")), FakeLauncher()) as sys:
        await sys.until(lambda: STARTED in sys.process_events("/p"))
        immortal = sys.launcher.processes["/p"][0]
        immortal.__class__ = Immortal
        sys.stop.request(reason="the test is over")
        await sys.until_stopped()
        assert immortal.stopped_with == ["stop", "kill"]
        immortal.end(Exit(signal=9))


def test_one_signal_beside_a_crash_does_not_hurry() -> None:
    stop = StopRequests()
    stop.request(reason="/p has ended")
    stop.request(2)
    assert not stop.hurry.is_set()
    stop.request(2)
    assert stop.hurry.is_set()


async def test_a_file_that_cannot_be_looked_for_is_waited_for_and_holds_up_nothing_else() -> None:
    name = f"/{'x' * 300}"
    config = system(process("p"), process("late"), process("later"))
    config = rules(
        config,
        late=on(Condition.FILE, subject=name, timeout=5.0),
        later=on(Condition.FILE, subject=f"{name}/y"),
    )
    async with running(config, FakeLauncher()) as sys:
        await sys.until(lambda: "/late" in sys.gave_up())
        assert sys.view.processes["/p"].pid
        assert sys.view.processes["/later"].kind is ProcessEventKind.WAITING


async def test_a_node_that_unloads_itself_while_the_system_stops_is_logged_without_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.DEBUG)

    async with running(system(container("c", "a")), FakeLauncher()) as sys:
        await sys.until_loaded(1)
    found = [each for each in caplog.records if each.getMessage() == "/a is unloaded"]
    assert [each.levelname for each in found] == ["DEBUG"]
