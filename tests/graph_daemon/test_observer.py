"""What a replay records of the graph."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import signal
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from play_launch.graph_daemon import observer
from play_launch.graph_daemon.contract import DaemonAddress
from play_launch.graph_daemon.graph_client import GraphClient
from play_launch.graph_daemon.observer import (
    ORPHAN_TIMEOUT,
    _Observer,
    observe_graph,
)
from play_launch.graph_daemon.port import (
    OwnerKind,
    PortHeldError,
    PortOwner,
    find_owner,
    stop_daemon,
)
from play_launch.graph_daemon.start_stop import StartedDaemon, start_daemon
from play_launch.ros.fastdds.shared_memory import sweep
from play_launch.supervisor.events import GraphChanged, RunEvent
from tests.graph_daemon.occupants import occupied
from tests.support.ros import Probe


class Heard:
    """An event sink that keeps events."""

    def __init__(self) -> None:
        self.events: list[GraphChanged] = []

    def publish(self, event: RunEvent) -> None:
        assert isinstance(event, GraphChanged)
        self.events.append(event)

    def has(self, appeared: str = "", vanished: str = "") -> bool:
        return any(
            (appeared in event.appeared if appeared else vanished in event.vanished)
            for event in self.events
        )

    async def until(self, *, appeared: str = "", vanished: str = "") -> None:
        while not self.has(appeared, vanished):
            await asyncio.sleep(0.02)


@contextlib.asynccontextmanager
async def observed(heard: Heard) -> AsyncIterator[None]:
    """Have a session observe the graph; the daemon that it may start goes on afterwards."""
    observing = asyncio.create_task(observe_graph(os.environ, heard.publish))
    try:
        yield
        assert not observing.done()
    finally:
        observing.cancel()
        await asyncio.gather(observing, return_exceptions=True)


async def ours(address: DaemonAddress, *, but: int = 0) -> PortOwner:
    """Wait for a daemon of ours, another one than that process."""
    while True:
        owner = await asyncio.to_thread(find_owner, address)
        if owner.kind is OwnerKind.OURS and owner.status["pid"] != but:
            return owner


@pytest.fixture
def _ended(address: DaemonAddress, logs: Path) -> Iterator[None]:
    yield
    stop_daemon(address)
    assert find_owner(address).kind is OwnerKind.FREE


@pytest.mark.usefixtures("_ended")
def test_nodes_that_come_and_go_are_published(address: DaemonAddress) -> None:
    async def scenario(heard: Heard) -> None:
        async with observed(heard):
            # Without questions of any session the daemon ends.
            assert (await ours(address)).status["idle_timeout"] == ORPHAN_TIMEOUT
            before = time.time_ns()
            probe = await asyncio.to_thread(Probe, "visitor")
            await heard.until(appeared="/visitor")
            # The time of the change, not that of the question.
            assert before <= heard.events[-1].stamp_ns <= time.time_ns()
            await asyncio.to_thread(probe.__exit__, None, None, None)
            await heard.until(vanished="/visitor")

    heard = Heard()
    asyncio.run(asyncio.wait_for(scenario(heard), 120))
    assert not any("_ros2cli_daemon_" in str(event) for event in heard.events)


@pytest.mark.usefixtures("_ended")
def test_the_end_of_a_session_leaves_the_graph_to_the_others(address: DaemonAddress) -> None:
    async def scenario(heard: Heard) -> None:
        async with contextlib.AsyncExitStack() as first:
            await first.enter_async_context(observed(Heard()))
            started = await ours(address)
            async with observed(heard):
                first_seen = await asyncio.to_thread(Probe, "seen_by_both")
                await heard.until(appeared="/seen_by_both")
                await first.aclose()
                await asyncio.to_thread(first_seen.__exit__, None, None, None)
                await heard.until(vanished="/seen_by_both")
                assert (await ours(address)).status["pid"] == started.status["pid"]

    asyncio.run(asyncio.wait_for(scenario(Heard()), 120))


@pytest.mark.parametrize("kind", ["other", "impostor"])
def test_without_a_daemon_it_tries_again_and_warns_once(
    kind: str,
    address: DaemonAddress,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    caplog.set_level(logging.WARNING)
    monkeypatch.setattr(observer, "BETWEEN_STARTS", 0.1)
    problems: list[str] = []

    def counted(*arguments: Any, **options: Any) -> StartedDaemon:
        # A thread that is left behind must not start one for the next test.
        if len(problems) == 3:
            raise PortHeldError(problems[0])
        try:
            return start_daemon(*arguments, **options)
        except PortHeldError as error:
            problems.append(str(error))
            raise

    monkeypatch.setattr(observer, "start_daemon", counted)

    async def scenario() -> None:
        async with observed(Heard()):
            while len(problems) < 3:
                await asyncio.sleep(0.02)

    with occupied(kind, address.port):
        asyncio.run(asyncio.wait_for(scenario(), 120))
    (warning,) = [record.getMessage() for record in caplog.records]
    assert warning.startswith("no graph daemon: ")
    assert "has the daemon's port" in warning


@pytest.mark.usefixtures("_ended")
def test_a_daemon_that_dies_is_reported_once_and_started_again(
    address: DaemonAddress, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level(logging.WARNING)
    monkeypatch.setattr(observer, "BETWEEN_STARTS", 0.1)

    async def scenario(heard: Heard) -> None:
        async with observed(heard):
            killed = (await ours(address)).status["pid"]
            os.kill(killed, signal.SIGKILL)
            await ours(address, but=killed)
            probe = await asyncio.to_thread(Probe, "late_visitor")
            await heard.until(appeared="/late_visitor")
            await asyncio.to_thread(probe.__exit__, None, None, None)

    asyncio.run(asyncio.wait_for(scenario(Heard()), 120))
    assert caplog.text.count("does not answer") == 1
    # What the killed one left, unless another program of this machine was faster.
    sweep()


def test_a_domain_that_is_none_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    asyncio.run(observe_graph({"ROS_DOMAIN_ID": "banana"}, Heard().publish))
    assert "no graph daemon: ROS_DOMAIN_ID is a number" in caplog.text


def test_an_answer_that_is_older_than_the_change_is_not_the_last(address: DaemonAddress) -> None:
    """The daemon repeats answers for a while, also to a question that is younger than a change."""
    heard = Heard()
    observed_by = _Observer(address, heard.publish)
    generations = iter([(1, 9.0), (2, 0.1), (2, 1.2)])
    names = iter([["a", "b"], ["a", "b"], ["a"]])

    class Client:
        def call(self, _method: str, known: str) -> str:
            generation, unchanged_for = next(generations)
            if known == str(generation):
                return ""
            values = {"generation": generation, "unchanged_for": unchanged_for, "warm": True}
            return json.dumps(values)

        def nodes(self) -> list[Any]:
            return [SimpleNamespace(name=name, full_name=f"/{name}") for name in next(names)]

        def endpoints(self) -> list[Any]:
            return []

    observed_by._client = cast("GraphClient", Client())

    async def polls() -> None:
        for _ in range(3):
            await observed_by._poll()

    asyncio.run(polls())
    assert heard.has(vanished="/b")
