"""A run goes before others while a system comes up and while it ends, and not in between."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable

import pytest

from play_launch.cli import background
from play_launch.cli.background import run_ahead_of
from play_launch.runtime.publisher import Publisher
from play_launch.runtime.signals import StopRequests
from play_launch.supervisor.events import ContainerState, NodeState
from tests.cli.scenes import container, node

LONG = 60.0
"""Seconds, so that a failure ends."""


class Bench:
    """A run whose place among the others is written down instead of taken."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, is_permitted: bool = True) -> None:
        self.publisher = Publisher()
        self.stop = StopRequests()
        self.calls: list[str] = []
        self._is_permitted = is_permitted
        self._called = asyncio.Event()
        monkeypatch.setattr(background, "_PRIORITY_INTERVAL", 0.001)
        monkeypatch.setattr(background, "_LONGEST_START", math.inf)
        monkeypatch.setattr(background, "run_ahead", self._run_ahead)
        monkeypatch.setattr(background, "run_along", self._run_along)

    def _run_ahead(self) -> bool:
        self._note("ahead")
        return self._is_permitted

    def _run_along(self) -> None:
        self._note("along")

    def _note(self, call: str) -> None:
        self.calls.append(call)
        self._called.set()

    async def called(self, times: int, call: str = "ahead") -> None:
        """Wait for that many calls from now on."""
        seen = self.calls.count(call)
        while self.calls.count(call) < seen + times:
            self._called.clear()
            await self._called.wait()


def run(bench_and_more: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(bench_and_more(), LONG))


def test_ahead_until_all_is_loaded_and_again_from_the_stop_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def main() -> None:
        bench = Bench(monkeypatch)
        bench.publisher.publish(container("/c", ContainerState.STARTING))
        running = asyncio.ensure_future(run_ahead_of(bench.publisher, bench.stop))
        await bench.called(5)
        bench.publisher.publish(node("/c", 0, NodeState.LOADING))
        bench.publisher.publish(container("/c", ContainerState.RUNNING))
        await bench.called(5)
        assert "along" not in bench.calls
        bench.publisher.publish(node("/c", 0, NodeState.LOADED))
        await bench.called(1, "along")
        # A node that is loaded again disturbs no other.
        bench.publisher.publish(node("/c", 0, NodeState.LOADING))
        seen = len(bench.calls)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(bench.called(1), 0.02)
        assert len(bench.calls) == seen
        bench.stop.request(2)
        await running
        assert bench.calls[seen:] == ["ahead"]

    run(main)


def test_a_stop_while_it_comes_up(monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        bench = Bench(monkeypatch)
        bench.publisher.publish(container("/c", ContainerState.STARTING))
        running = asyncio.ensure_future(run_ahead_of(bench.publisher, bench.stop))
        await bench.called(1)
        bench.stop.request(2)
        await running
        assert bench.calls[-1] == "ahead"

    run(main)


def test_what_does_not_come_up_is_not_awaited_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        bench = Bench(monkeypatch)
        monkeypatch.setattr(background, "_LONGEST_START", 0.05)
        bench.publisher.publish(container("/c", ContainerState.STARTING))
        running = asyncio.ensure_future(run_ahead_of(bench.publisher, bench.stop))
        await bench.called(1, "along")
        bench.stop.request(2)
        await running

    run(main)


def test_without_permission_it_is_not_tried_again_before_the_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def main() -> None:
        bench = Bench(monkeypatch, is_permitted=False)
        running = asyncio.ensure_future(run_ahead_of(bench.publisher, bench.stop))
        await bench.called(1, "along")
        bench.stop.request(2)
        await running
        assert bench.calls == ["ahead", "along", "ahead"]

    run(main)
