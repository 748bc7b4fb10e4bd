"""A node dies with a lock that its neighbours need: through the real command."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from rosbags.highlevel import AnyReader

from tests.support.replay import Replay, alive, replaying

STARTED, READY, EXITED, RESTARTING, STOPPING = [
    "started",
    "ready",
    "exited",
    "restarting",
    "stopping",
]
PROCESS = 2

CONFIG = """
version: 1
containers:
  - name: lab
    container_type: {kind}
    isolation: shared_memory
    on_crash: ignore
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::Locker
        name: holder
        parameters: {{lock: mutex, hold_from: 1}}
      - package: play_launch_demo
        plugin: play_launch_demo::Locker
        name: waiting
        parameters: {{lock: mutex, rate: 1000.0}}
      - package: play_launch_demo
        plugin: play_launch_demo::Locker
        name: busy
        parameters: {{lock: none, hold_from: 1}}
"""
NODES = ("/holder", "/waiting", "/busy")


def configuration(path: Path, kind: str) -> Path:
    file = path / "locks.yaml"
    file.write_text(CONFIG.format(kind=kind), encoding="utf-8")
    return file


def is_process(kind: str) -> Any:
    return lambda event: (
        (event["event"], event.get("name"), event.get("kind"))
        == (
            "process",
            "/lab",
            kind,
        )
    )


def loaded(replay: Replay) -> dict[str, dict[str, Any]]:
    """Wait until all nodes are loaded, from now on; their events."""
    found: dict[str, dict[str, Any]] = {}

    def done(event: dict[str, Any]) -> bool:
        if event["event"] == "component" and event["kind"] == "loaded":
            found[event["full_node_name"]] = event
        return len(found) == len(NODES)

    replay.read_until(done, "all nodes loaded")
    return found


def keeping(replay: Replay) -> int:
    """How many nodes have said that they hold a lock now."""
    lines = (event["text"] for event in replay.seen if event["event"] == "output")
    return sum("Keeping the lock" in line for line in lines)


def read(reader: AnyReader, raw: bytes, kind: str) -> Any:
    return reader.deserialize(raw, kind)


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
        first = loaded(replay)
        container = next(event for event in replay.seen if is_process("started")(event))
        # The busy one keeps a lock as well, that of nobody.
        if keeping(replay) < 2:
            replay.read_until(lambda _: keeping(replay) == 2, "that the lock is held")
        family = [psutil.Process(event["pid"]) for event in first.values()]
        os.kill(first["/holder"]["pid"], signal.SIGKILL)
        stopping = replay.read_until(is_process("stopping"), "that it is found")
        assert "a node died with a lock" in stopping["message"]
        assert f"of process {first['/waiting']['pid']} waits" in stopping["message"]
        assert f"held by process {first['/holder']['pid']}" in stopping["message"]
        exited = replay.read_until(is_process("exited"), "its end")
        assert (exited["pid"], exited["signal"]) == (container["pid"], signal.SIGKILL)
        second = loaded(replay)
        assert not alive(family)
        assert not {event["pid"] for event in first.values()} & {
            event["pid"] for event in second.values()
        }
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
    assert replay.process.returncode == 128 + signal.SIGTERM
    crashes = [
        event
        for event in replay.seen
        if event["event"] == "component" and event["kind"] == "crashed"
    ]
    assert [(each["full_node_name"], each["signal"]) for each in crashes] == [
        ("/holder", signal.SIGKILL)
    ]
    with AnyReader([replay.bag]) as reader:
        chain = [
            message.state
            for connection, _, raw in reader.messages()
            if connection.topic == "/play_launch/states"
            and (message := read(reader, raw, connection.msgtype)).name == "/lab"
            and message.kind == PROCESS
        ]
    assert chain == [
        *(STARTED, READY, STOPPING, EXITED, RESTARTING),
        *(STARTED, READY, STOPPING, EXITED),
    ]


def test_nodes_that_hang_without_a_death_are_told_of_and_left_alone(left_alone: Replay) -> None:
    loaded(left_alone)
    told: set[str] = set()

    def all_told(event: dict[str, Any]) -> bool:
        if event["event"] == "node" and "blocked in a callback" in event["reason"]:
            told.add(event["node"])
        return told == set(NODES)

    # The holder sleeps in a callback, one waits for its lock, one is just busy.
    left_alone.read_until(all_told, "that they are busy")
    left_alone.process.send_signal(signal.SIGTERM)
    left_alone.read_all()
    assert len([event for event in left_alone.seen if is_process("started")(event)]) == 1
    assert not [event for event in left_alone.seen if is_process("restarting")(event)]
