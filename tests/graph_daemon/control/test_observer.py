"""What a replay records of the graph."""

from __future__ import annotations

import asyncio
import logging
import os
import time
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.core.events import GraphChanged, RunEvent
from play_launch.graph_daemon.contract import LISTENING, DaemonAddress
from play_launch.graph_daemon.control.observer import (
    FORSAKEN,
    LONGEST_LOOK,
    LOOK,
    changes,
    next_look,
    observed_graph,
)
from play_launch.graph_daemon.control.start_stop import start_daemon, stop_daemon
from play_launch.graph_daemon.control.takeover import Kind, look
from tests.graph_daemon.control.occupants import occupied
from tests.support.ros import Probe

names = st.lists(st.sampled_from(["/a", "/b", "/c"])).map(Counter)


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


@given(names, names)
def test_changes_lead_from_one_list_to_the_other(before: Counter[str], now: Counter[str]) -> None:
    event = changes(before, now, 5)
    if event is None:
        assert before == now
        return
    reached = before + Counter(event.appeared)
    reached.subtract(event.vanished)
    assert +reached == now
    assert event.nodes == now.total()
    assert not set(event.appeared) & set(event.vanished)


@given(st.lists(st.floats(0.0, 100.0), max_size=20))
def test_at_rest_it_is_asked_seldom_and_in_a_storm_not_often(moments: list[float]) -> None:
    """Each question takes time of the daemon, which is to need next to none at rest."""
    pending = sorted(moments)
    now, pause, looks = 0.0, LOOK, 0
    while now < 120.0:
        changed = bool(pending) and pending[0] <= now
        # What changed is seen before the longest pause is over.
        assert not changed or now - pending[0] <= LONGEST_LOOK
        pending = [moment for moment in pending if moment > now]
        pause = next_look(pause, changed=changed)
        assert LOOK <= pause <= LONGEST_LOOK
        now += pause
        looks += 1
    assert looks <= 120.0 / LONGEST_LOOK + 5 * (len(moments) + 1)


def test_nodes_that_come_and_go_are_published(address: DaemonAddress, logs: Path) -> None:
    async def scenario(heard: Heard) -> None:
        async with observed_graph(os.environ, heard):
            occupant = await asyncio.to_thread(look, address)
            assert occupant.kind is Kind.OURS
            # Should this process be killed, the daemon does not stay for ever.
            assert occupant.status["idle_timeout"] == FORSAKEN
            before = time.time_ns()
            probe = await asyncio.to_thread(Probe, "visitor")
            await heard.until(appeared="/visitor")
            # The time of the change, not that of the question.
            assert before <= heard.events[-1].stamp_ns <= time.time_ns()
            await asyncio.to_thread(probe.__exit__, None, None, None)
            await heard.until(vanished="/visitor")

    heard = Heard()
    asyncio.run(asyncio.wait_for(scenario(heard), 120))
    assert look(address).kind is Kind.NOBODY
    assert not any("_ros2cli_daemon_" in str(event) for event in heard.events)


def test_a_daemon_that_ran_before_goes_on(address: DaemonAddress, logs: Path) -> None:
    started = start_daemon(address, wait_for=LISTENING)

    async def scenario() -> None:
        async with observed_graph(os.environ, Heard()):
            pass

    asyncio.run(asyncio.wait_for(scenario(), 120))
    assert look(address).status["pid"] == started.pid
    stop_daemon(address)
    assert started.process is not None
    assert started.process.wait(60) == 0


def test_without_a_daemon_the_system_runs_all_the_same(
    address: DaemonAddress, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    ran = []

    async def scenario() -> None:
        async with observed_graph(os.environ, Heard()):
            ran.append(True)

    with occupied("other", address.port):
        asyncio.run(asyncio.wait_for(scenario(), 120))
    assert ran == [True]
    assert "no graph daemon" in caplog.text
    assert "has the daemon's port" in caplog.text


def test_a_daemon_that_dies_is_reported_once(
    address: DaemonAddress, logs: Path, caplog: pytest.LogCaptureFixture
) -> None:
    import signal

    from play_launch.fastdds.shared_memory import sweep

    caplog.set_level(logging.WARNING)

    async def scenario() -> None:
        async with observed_graph(os.environ, Heard()):
            occupant = await asyncio.to_thread(look, address)
            assert occupant.holder is not None
            os.kill(occupant.holder.pid, signal.SIGKILL)
            while "does not answer" not in caplog.text:
                await asyncio.sleep(0.02)
            await asyncio.sleep(1.2)

    asyncio.run(asyncio.wait_for(scenario(), 120))
    assert caplog.text.count("does not answer") == 1
    # What the killed one left, unless another program of this machine was faster.
    sweep()
