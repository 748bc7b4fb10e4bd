"""What follows when a node of a container crashes alone."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest

from play_launch.config.model import OnCrash, RestartLimits
from play_launch.config.node_key import NodeKey
from play_launch.container.messages import Load
from play_launch.supervisor.events import (
    ComponentEventKind,
    ContainerState,
    NodeState,
)
from play_launch.supervisor.outcome import Cause, Sequel

from .fakes import FakeContainer, FakeLauncher, Held, container, node, system
from .running import Running, running

if TYPE_CHECKING:
    from collections.abc import Callable


def launcher(*makers: Callable[..., FakeContainer]) -> FakeLauncher:
    return FakeLauncher(makers={"/c": list(makers)} if makers else {})


def loads(fake: FakeContainer, name: str = "a") -> list[Load]:
    sent = fake.link.sent
    return [each for each in sent if isinstance(each, Load) and each.node_name == name]


def the_container(sys: Running) -> FakeContainer:
    return sys.launcher.containers["/c"][-1]


def crashes(sys: Running, name: str) -> int:
    return len(sys.node_events(name, NodeState.CRASHED))


async def crash(sys: Running, name: str, **facts: Any) -> None:
    """Let a node crash, and wait until that has arrived."""
    before = crashes(sys, f"/{name}")
    the_container(sys).crash_node(name, **facts)
    await sys.until(lambda: crashes(sys, f"/{name}") > before)


class AlwaysCrashes(FakeContainer):
    """Node a crashes as soon as it is loaded."""

    def construct(self, held: Held) -> None:
        super().construct(held)
        if held.load.node_name == "a":
            self.crash_node("a")


async def test_the_first_reload_is_at_once_and_the_neighbours_notice_nothing() -> None:
    async with running(system(container("c", "a", "b")), launcher()) as sys:
        await sys.until_loaded(2)
        frames = (
            "#0 libc.so.6+0x8aeec",
            "#1 abort+0xd3 (component_container+0x2)",
            "#2 burn()+0x4 (libstove.so+0x3)",
            "#3 main",
        )
        await crash(sys, "a", error="at 0x0", backtrace=frames)
        crashed = asyncio.get_running_loop().time()
        await sys.until_loaded(2)
        assert asyncio.get_running_loop().time() == crashed
        assert len(sys.launcher.containers["/c"]) == 1
        view = sys.view.containers["/c"].nodes[NodeKey("/c", "/a")]
        assert (view.crashes, view.reloads) == (1, 1)
        assert [each.node for each in sys.view.crashed] == ["/a"]
    assert sys.node_states("/b").count(NodeState.LOADED) == 1
    (told,) = sys.node_events("/a", NodeState.CRASHED)
    assert told.reason == (
        "exited with signal 11 (SIGSEGV): at 0x0 at #2 burn()+0x4 (libstove.so+0x3); "
        "it is loaded again at once"
    )
    assert told.crashes == 1
    assert (told.cause, told.sequel, told.delay_ns) == (Cause.SIGNAL, Sequel.RELOAD, 0)
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (" ", "exited with signal 11 (SIGSEGV):  "),
        ("SIGSEGV (at 0x0) in thread 'a'", "SIGSEGV (at 0x0) in thread 'a'"),
    ],
)
async def test_a_crash_names_its_signal_once(error: str, reason: str) -> None:
    async with running(system(container("c", "a")), launcher()) as sys:
        await sys.until_loaded(1)
        await crash(sys, "a", error=error)
        await sys.until_loaded(1)
    (told,) = sys.node_events("/a", NodeState.CRASHED)
    assert told.reason == f"{reason}; it is loaded again at once"


async def test_it_is_loaded_again_within_its_own_bounds_and_then_given_up(
    caplog: pytest.LogCaptureFixture,
) -> None:
    limits = RestartLimits(max_restarts=4, initial=0.1, maximum=0.2)
    config = system(container("c", node("a", restart=limits), "b", max_restarts=0))
    async with running(config, launcher(AlwaysCrashes)) as sys:
        await sys.until(lambda: bool(sys.node_events("/a", NodeState.GAVE_UP)))
    assert len(loads(the_container(sys))) == 5
    assert crashes(sys, "/a") == 5
    told = sys.node_events("/a", NodeState.CRASHED)
    assert [each.sequel for each in told] == [Sequel.RELOAD] * 4 + [Sequel.GAVE_UP]
    pauses = [each.delay_ns / 1e9 for each in told]
    assert pauses[0] == 0
    assert 0.05 <= pauses[1] <= 0.1 <= pauses[2] <= 0.2
    assert 0.1 <= pauses[3] <= 0.2
    (given_up,) = sys.node_events("/a", NodeState.GAVE_UP)
    assert (given_up.cause, given_up.sequel) == (Cause.SIGNAL, Sequel.GAVE_UP)
    assert "restart limit reached (4 in 60 s)" in given_up.reason
    assert (given_up.crashes, given_up.reloads) == (5, 4)
    assert "/a is not loaded again" in caplog.text
    assert len(sys.launcher.containers["/c"]) == 1
    assert sys.outcome is not None
    assert sys.outcome.view.loaded == 1
    assert sys.outcome.exit_code == 1


async def test_a_healthy_life_starts_the_pauses_and_the_count_anew() -> None:
    config = system(container("c", node("a", restart=RestartLimits(max_restarts=1))))
    async with running(config, launcher()) as sys:
        for _ in range(3):
            await sys.until_loaded(1)
            await asyncio.sleep(61)
            await crash(sys, "a")
            assert sys.node_states("/a")[-1] is not NodeState.GAVE_UP
        reasons = [event.reason for event in sys.node_events("/a", NodeState.CRASHED)]
        assert all("at once" in reason for reason in reasons)


async def test_nodes_count_for_themselves() -> None:
    config = system(container("c", node("a", restart=RestartLimits(max_restarts=1)), "b"))
    async with running(config, launcher()) as sys:
        await sys.until_loaded(2)
        await crash(sys, "a")
        await sys.until_loaded(2)
        await crash(sys, "b")
        assert "at once" in sys.node_events("/b", NodeState.CRASHED)[0].reason
        await crash(sys, "a")
        assert sys.node_states("/a")[-1] is NodeState.GAVE_UP
        await sys.until_loaded(1)


async def test_a_reload_that_fails_is_tried_again_within_the_bounds() -> None:
    class Busy(FakeContainer):
        """Its device is free again at the third try."""

        def construct(self, held: Held) -> None:
            if 1 < held.load.attempt < 4:
                del self.held[held.unique_id]
                self.say(ComponentEventKind.LOAD_FAILED, held, error="device busy")
            else:
                super().construct(held)

    async with running(system(container("c", "a")), launcher(Busy)) as sys:
        await sys.until_loaded(1)
        await crash(sys, "a")
        await sys.until_loaded(1)
        failures = sys.node_events("/a", NodeState.LOAD_FAILED)
        assert ["device busy; it is loaded again in" in each.reason for each in failures] == [
            True,
            True,
        ]
        view = sys.view.containers["/c"].nodes[NodeKey("/c", "/a")]
        assert (view.crashes, view.reloads) == (1, 3)


async def test_ignored_it_stays_away_until_its_container_is_started_anew() -> None:
    config = system(container("c", node("a", OnCrash.IGNORE), "b"), duration=500.0)
    async with running(config, launcher()) as sys:
        await sys.until_loaded(2)
        await crash(sys, "a")
        await asyncio.sleep(100)
        assert len(loads(the_container(sys))) == 1
        assert sys.view.loaded == 1
        assert [each.node for each in sys.view.failed] == ["/a"]
        the_container(sys).crash()
        await sys.until_loaded(2)
        await crash(sys, "a")
        await sys.stop.requested.wait()
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 1


async def test_the_run_ends_when_its_only_container_is_stopped() -> None:
    config = system(container("c", node("a", OnCrash.STOP_CONTAINER)))
    async with running(config, launcher()) as sys:
        await sys.until_loaded(1)
        the_container(sys).crash_node("a")
        await sys.stop.requested.wait()
    assert sys.outcome is not None
    assert (sys.stop.reason, sys.outcome.exit_code) == ("nothing is left to run", 1)


async def test_a_node_that_crashes_while_its_container_stops_is_left_alone() -> None:
    class CrashesAtTheEnd(FakeContainer):
        def on_shutdown(self) -> None:
            self.crash_node("a")
            super().on_shutdown()

    config = system(container("c", node("a", OnCrash.RELOAD)))
    async with running(config, launcher(CrashesAtTheEnd)) as sys:
        await sys.until_loaded(1)
    assert len(loads(the_container(sys))) == 1
    assert crashes(sys, "/a") == 1
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 1


async def test_a_pending_reload_dies_with_its_container_and_the_new_one_loads_it() -> None:
    limits = RestartLimits(max_restarts=9, initial=50.0, maximum=100.0)
    async with running(system(container("c", node("a", restart=limits))), launcher()) as sys:
        await sys.until_loaded(1)
        await crash(sys, "a")
        await sys.until_loaded(1)
        await crash(sys, "a")
        the_container(sys).crash()
        await sys.until_loaded(1)
        await asyncio.sleep(200)
        assert [len(loads(each)) for each in sys.launcher.containers["/c"]] == [2, 1]


async def test_one_that_was_given_up_does_not_come_back_with_its_container() -> None:
    config = system(container("c", node("a", restart=RestartLimits(max_restarts=0)), "b"))
    async with running(config, launcher()) as sys:
        await sys.until_loaded(2)
        await crash(sys, "a")
        the_container(sys).crash()
        await sys.until_state("/c", ContainerState.BACKOFF)
        await sys.until_loaded(1)
        assert not loads(the_container(sys))
        assert sys.node_states("/a")[-1] is NodeState.GAVE_UP


async def test_a_crash_in_the_constructor_is_no_long_life_after_a_long_life_before() -> None:
    """The node lives long, its container dies, and the next attempt crashes while it is built."""

    class CrashesInConstructor(FakeContainer):
        def construct(self, held: Held) -> None:
            self.crash_node(held.load.node_name)

    limits = RestartLimits(max_restarts=3, initial=4.0, maximum=30.0)
    config = system(container("c", node("a", restart=limits)))
    async with running(config, launcher(FakeContainer, CrashesInConstructor)) as sys:
        for _ in range(2):
            await sys.until_loaded(1)
            await crash(sys, "a")
        await sys.until_loaded(1)
        await asyncio.sleep(100)
        the_container(sys).crash()
        await sys.until(lambda: crashes(sys, "/a") == 3)
    reasons = [event.reason for event in sys.node_events("/a", NodeState.CRASHED)]
    assert ["at once" in reason for reason in reasons] == [True, False, False]
