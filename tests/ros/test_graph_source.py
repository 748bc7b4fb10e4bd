"""When somebody looks at the ROS graph, with a stand-in for the thread that has a node."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import Any, cast

import pytest

from play_launch.config.dependency import Condition
from play_launch.ros import graph_source
from play_launch.ros.graph_source import GraphSource, Wanted
from play_launch.ros.shared_thread import SharedRosThread

pytestmark = pytest.mark.anyio

TALKER = (Condition.NODE, "/talker")
SERVICE = (Condition.SERVICE, "/c/load")


class StandIn:
    """All that is wanted is there; it comes and goes when the test lets it."""

    def __init__(self) -> None:
        self.is_leaving = asyncio.Event()
        self.may_leave = asyncio.Event()
        self.times = 0

    @asynccontextmanager
    async def used(self) -> AsyncIterator[StandIn]:
        self.times += 1
        try:
            yield self
        finally:
            self.is_leaving.set()
            await self.may_leave.wait()

    def listen(self, _on_change: Callable[[], None]) -> Callable[[], None]:
        return lambda: None

    async def call(self, work: partial[Wanted]) -> Any:
        return work.keywords["wanted"]


async def test_what_is_wanted_while_the_node_leaves_is_looked_for() -> None:
    ros = StandIn()
    seen: asyncio.Queue[Wanted] = asyncio.Queue()
    source = GraphSource(cast(SharedRosThread, ros), seen.put_nowait)
    source.watch([TALKER])
    assert await seen.get() == {TALKER}
    source.watch([])
    await ros.is_leaving.wait()
    source.watch([SERVICE])
    ros.may_leave.set()
    assert await asyncio.wait_for(seen.get(), 60) == {SERVICE}
    await source.close()
    assert ros.times == 2


async def test_a_graph_that_cannot_be_read_is_reported_and_read_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class NoRosAtFirst(StandIn):
        @asynccontextmanager
        async def used(self) -> AsyncIterator[StandIn]:
            self.times += 1
            if self.times == 1:
                raise ImportError("no rclpy")
            yield self

    monkeypatch.setattr(graph_source, "_RETRY_INTERVAL", 0.0)
    ros = NoRosAtFirst()
    seen: asyncio.Queue[Wanted] = asyncio.Queue()
    source = GraphSource(cast(SharedRosThread, ros), seen.put_nowait)
    source.watch([TALKER])
    assert await asyncio.wait_for(seen.get(), 60) == {TALKER}
    await source.close()
    assert [record.getMessage() for record in caplog.records] == [
        "the ROS graph cannot be read, next try in 0 s: no rclpy"
    ]
