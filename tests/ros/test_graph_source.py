"""Reading of the ROS graph while something is awaited, with a stand-in for the pool of nodes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

import pytest

from play_launch.config.dependency import Condition
from play_launch.ros import access
from play_launch.ros.access import GraphSource, Wanted

pytestmark = pytest.mark.anyio

TALKER = (Condition.NODE, "/talker")
SERVICE = (Condition.SERVICE, "/c/load")


class StandIn:
    """All that is wanted is there; it comes and goes when the test lets it."""

    def __init__(self) -> None:
        self.is_leaving = asyncio.Event()
        self.may_leave = asyncio.Event()
        self.checked = asyncio.Event()
        self.graph_changes = 0
        self.times = 0

    @asynccontextmanager
    async def used(self, _environment: object) -> AsyncIterator[StandIn]:
        self.times += 1
        try:
            yield self
        finally:
            self.is_leaving.set()
            await self.may_leave.wait()

    def check_again(self) -> None:
        self.checked.set()

    async def until(self, holds: Callable[[object], bool]) -> None:
        while not holds(self):
            await self.checked.wait()
            self.checked.clear()

    async def call(self, work: partial[Wanted]) -> Any:
        return work.keywords["wanted"]


async def test_what_is_wanted_while_the_node_leaves_is_looked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ros = StandIn()
    monkeypatch.setattr(access, "node_pool", ros)
    seen: asyncio.Queue[Wanted] = asyncio.Queue()
    source = GraphSource({}, seen.put_nowait)
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
        async def used(self, _environment: object) -> AsyncIterator[StandIn]:
            self.times += 1
            if self.times == 1:
                raise ImportError("no rclpy")
            yield self

    monkeypatch.setattr(access, "_RETRY_INTERVAL", 0.0)
    monkeypatch.setattr(access, "node_pool", NoRosAtFirst())
    seen: asyncio.Queue[Wanted] = asyncio.Queue()
    source = GraphSource({}, seen.put_nowait)
    source.watch([TALKER])
    assert await asyncio.wait_for(seen.get(), 60) == {TALKER}
    await source.close()
    assert [record.getMessage() for record in caplog.records] == [
        "the ROS graph cannot be read, next try in 0 s: no rclpy"
    ]
