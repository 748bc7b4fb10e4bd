"""A node dies with a lock that its neighbours need: through the real command."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from tests.support.replay import Replay, alive, recorded, replaying, run
from tests.support.scenes import container, node, written

PROCESS = 2

NODES = ("/holder", "/waiting", "/busy")


def configuration(path: Path, kind: str) -> Path:
    lockers = [
        node("holder", "Locker", parameters={"lock": "mutex", "hold_from": 1}),
        node("waiting", "Locker", parameters={"lock": "mutex", "rate": 1000.0}),
        node("busy", "Locker", parameters={"lock": "none", "hold_from": 1}),
    ]
    how = {"container_type": kind, "isolation": "shared_memory", "on_crash": "ignore"}
    return written(path, containers=[container("lab", *lockers, **how)])


def keeping(replay: Replay) -> int:
    """How many nodes have said that they hold a lock now."""
    lines = (event["text"] for event in replay.seen if event["event"] == "output")
    return sum("Keeping the lock" in line for line in lines)


@pytest.fixture(scope="module")
def left_alone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Replay]:
    """A run whose nodes hang and do not die; it takes its time beside the other tests."""
    folder = tmp_path_factory.mktemp("left_alone")
    with replaying(configuration(folder, "isolated"), folder / "logs") as replay:
        yield replay


@pytest.mark.usefixtures("left_alone")
@pytest.mark.parametrize("kind", ["isolated", "isolated_mt"])
def test_a_container_whose_living_nodes_wait_for_a_dead_one_is_started_anew(
    kind: str, tmp_path: Path
) -> None:
    with replaying(configuration(tmp_path, kind), tmp_path / "logs") as replay:
        first = replay.read_until_up(*NODES)
        started = replay.told(name="/lab", kind="started")[0]
        # The busy one keeps a lock as well, that of nobody.
        if keeping(replay) < 2:
            replay.read_until(lambda _: keeping(replay) == 2, "that the lock is held")
        family = [psutil.Process(first[name]["pid"]) for name in NODES]
        os.kill(first["/holder"]["pid"], signal.SIGKILL)
        stopping = replay.until(name="/lab", kind="stopping")
        assert "a node died with a lock" in stopping["message"]
        assert f"of process {first['/waiting']['pid']} waits" in stopping["message"]
        assert f"held by process {first['/holder']['pid']}" in stopping["message"]
        exited = replay.until(name="/lab", kind="exited")
        assert (exited["pid"], exited["signal"]) == (started["pid"], signal.SIGKILL)
        second = replay.read_until_up(*NODES)
        assert not alive(family)
        assert not {each["pid"] for each in first.values()} & {
            each["pid"] for each in second.values()
        }
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
    assert replay.process.returncode == 128 + signal.SIGTERM
    crashes = replay.told(event="component", kind="crashed")
    assert [(each["full_node_name"], each["signal"]) for each in crashes] == [
        ("/holder", signal.SIGKILL)
    ]
    chain = [
        each.state
        for each in recorded(replay.bag, "/play_launch/states")
        if (each.kind, each.name) == (PROCESS, "/lab")
    ]
    assert chain == [
        *("started", "ready", "stopping", "exited", "restarting"),
        *("started", "ready", "stopping", "exited"),
    ]
    explained = run("explain", replay.bag, code=1).stdout
    assert "/holder in /lab crashed" in explained
    assert "/lab was killed: a node died with a lock" in explained
    assert "Also affected: /lab, /waiting" in explained


def test_nodes_that_hang_without_a_death_are_told_of_and_left_alone(left_alone: Replay) -> None:
    left_alone.read_until_up(*NODES)
    told: set[str] = set()

    def all_told(event: dict[str, Any]) -> bool:
        if event["event"] == "node" and "blocked in a callback" in event["reason"]:
            told.add(event["node"])
        return told == set(NODES)

    # The holder sleeps in a callback, one waits for its lock, one is just busy.
    left_alone.read_until(all_told, "that they are busy")
    left_alone.process.send_signal(signal.SIGTERM)
    left_alone.read_all()
    assert len(left_alone.told(name="/lab", kind="started")) == 1
    assert not left_alone.told(name="/lab", kind="restarting")
