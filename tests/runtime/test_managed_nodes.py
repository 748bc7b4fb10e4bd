"""Managed nodes beside their members, with scripted lifecycle services."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from types import MappingProxyType

import pytest
from msgspec.structs import replace

from play_launch.config.model import Autostart, ManagedConfig, ReplayConfig
from play_launch.config.node_key import NodeKey
from play_launch.ros.access import GraphSource, RosAccess, Wanted
from play_launch.ros.managed_node import ManagedNodeClient
from play_launch.supervisor.events import ManagedNodeChanged, ManagedState, NodeState

from .fakes import FakeLauncher, container, process, system
from .running import Running, running

State = ManagedState
WAY = [State.ASKED, State.CONFIGURING, State.ACTIVATING, State.ACTIVE]


class FakeNode(ManagedNodeClient):
    """Goes where it is told; `refuses` a transition, `raises` in one, or takes its time for each.

    `takes` is in seconds.
    """

    def __init__(self, on_state: Callable[[int], None]) -> None:
        self.on_state = on_state
        self.refuses = 0
        self.raises = 0
        self.takes = 0.0
        self.is_heard = True
        self.is_open = True
        self.is_offered = True
        self.is_silent = False
        self.at = 1

    async def state(self) -> int:
        if self.is_silent:
            await asyncio.Event().wait()
        return self.at

    async def change(self, transition: int) -> bool:
        await asyncio.sleep(self.takes)
        if transition == self.raises:
            self.at = 1
            self.on_state(self.at)
            return False
        if transition == self.refuses:
            return False
        self.at = {1: 2, 3: 3}[transition]
        if self.is_heard:
            self.on_state(self.at)
        return True


class FakeRos(RosAccess):
    def __init__(self, **traits: float) -> None:
        self.traits = traits
        self.nodes: list[FakeNode] = []

    def watch_graph(self, on_change: Callable[[Wanted], None]) -> GraphSource:
        raise AssertionError

    @asynccontextmanager
    async def managed_node(
        self, name: str, on_state: Callable[[int], None]
    ) -> AsyncIterator[FakeNode]:
        assert all(not each.is_open for each in self.nodes), "two conversations with one node"
        node = FakeNode(on_state)
        self.nodes.append(node)
        vars(node).update(self.traits)
        try:
            yield node
        finally:
            node.is_open = False


def managed(goal: Autostart = Autostart.ACTIVATE, timeout: float = 60.0) -> ReplayConfig:
    found = {"/c:/n": ManagedConfig("/n", goal, timeout)}
    return replace(system(container("c", "n")), managed=MappingProxyType(found))


def states(sys: Running) -> list[ManagedState]:
    return [event.state for event in sys.events if isinstance(event, ManagedNodeChanged)]


async def test_it_is_brought_up_again_with_each_life() -> None:
    ros = FakeRos()
    async with running(managed(), FakeLauncher(), ros=ros) as sys:
        await sys.until(lambda: states(sys) == WAY)
        sys.operated.restart(NodeKey("/c", "/n"))
        await sys.until(lambda: states(sys) == [*WAY, State.ABSENT, *WAY])
        sys.operated.restart("/c", "try it")
        await sys.until(lambda: states(sys).count(State.ACTIVE) == 3)
    assert [each.is_open for each in ros.nodes] == [False] * 3
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0


async def test_configure_goes_so_far_and_no_further() -> None:
    async with running(managed(Autostart.CONFIGURE), FakeLauncher(), ros=FakeRos()) as sys:
        await sys.until(lambda: State.INACTIVE in states(sys))
        await asyncio.sleep(100)
        assert states(sys) == [State.ASKED, State.CONFIGURING, State.INACTIVE]


async def test_a_node_that_leaves_in_a_transition_is_not_waited_for() -> None:
    async with running(managed(), FakeLauncher(), ros=FakeRos(takes=1000.0)) as sys:
        await sys.until(lambda: State.CONFIGURING in states(sys))
        assert not sys.view.is_complete
        sys.operated.stop(NodeKey("/c", "/n"))
        await sys.until(lambda: NodeState.UNLOADED in sys.node_states("/n"))
        assert states(sys)[-1] is State.ABSENT


async def test_a_managed_process_that_is_activated_by_hand() -> None:
    ros = FakeRos(refuses=3)
    config = system(process("p"))
    config = replace(
        config, managed=MappingProxyType({"/p": ManagedConfig("/p", Autostart.ACTIVATE)})
    )
    async with running(config, FakeLauncher(), ros=ros) as sys:
        await sys.until(lambda: State.FAILED in states(sys))
        ros.nodes[0].on_state(3)
        await sys.until(lambda: State.ACTIVE in states(sys))
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0


async def test_one_that_is_no_longer_managed_may_fail(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class FailsWhenCancelled(FakeNode):
        async def state(self) -> int:
            try:
                await asyncio.Event().wait()
            finally:
                raise LookupError("the node is gone")

    class Ros(FakeRos):
        @asynccontextmanager
        async def managed_node(
            self, name: str, on_state: Callable[[int], None]
        ) -> AsyncIterator[FakeNode]:
            self.nodes.append(FailsWhenCancelled(on_state))
            yield self.nodes[-1]

    ros = Ros()
    async with running(managed(), FakeLauncher(), ros=ros) as sys:
        await sys.until(lambda: states(sys) == [State.ASKED])
        await asyncio.sleep(1)
        await sys.operated.applying.apply(system(container("c", "n", "m")))
        await sys.until_loaded(2)
        await asyncio.sleep(1)
    assert sys.outcome is not None
    assert sys.outcome.exit_code == 0
    assert "the node is gone" in caplog.text


async def test_a_state_is_seen_although_its_event_gets_lost() -> None:
    ros = FakeRos()
    async with running(managed(Autostart.CONFIGURE), FakeLauncher(), ros=ros) as sys:
        await sys.until(lambda: State.INACTIVE in states(sys))
        # Another program activates it before our subscription is known to the node.
        ros.nodes[0].at = 3
        await sys.until(lambda: states(sys)[-1] is State.ACTIVE)


async def test_a_failure_is_not_forgotten_by_looking_again() -> None:
    ros = FakeRos(refuses=3, is_heard=False)
    async with running(managed(), FakeLauncher(), ros=ros) as sys:
        await sys.until(lambda: State.FAILED in states(sys))
        await asyncio.sleep(100)
        assert states(sys)[-1] is State.FAILED
