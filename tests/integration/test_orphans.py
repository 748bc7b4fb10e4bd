"""A supervisor that is killed leaves nothing behind, whatever its nodes did to get away."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import psutil

from play_launch.ros.fastdds.shared_memory import SHARED_MEMORY, sweep
from tests.process.test_guard import ESCAPES, escaping
from tests.support.replay import Replay, alive, replaying
from tests.support.scenes import container, node, written
from tests.support.waiting import until

ESCAPED = 7
"""Processes that `ESCAPES` let loose."""
LIMIT = 1.0
"""Seconds from the death of the supervisor to that of everything else."""


def configuration() -> dict[str, Any]:
    kinds = ("standard", "isolated")
    return {
        "version": 1,
        # It has a guard of its own, and a test of its own in tests/recording/topic_recorder.
        "record": {"ros": False},
        "containers": [
            container(kind, node(f"talker_{kind}"), container_type=kind) for kind in kinds
        ],
        "nodes": [{"name": how.replace(" ", "_"), "command": escaping(how)} for how in ESCAPES],
    }


def started(replay: Replay, *more: str) -> list[psutil.Process]:
    """Wait until everything runs and has let loose what gets away; give all of it."""
    waiting = {f"/{how.replace(' ', '_')}" for how in ESCAPES} | {"/talker_standard"}
    waiting |= {"/talker_isolated", *more}
    pids: set[int] = set()

    def is_last(event: dict[str, Any]) -> bool:
        if event["event"] == "output" and event["process"] in waiting:
            if event["text"] == "ready":
                waiting.discard(event["process"])
            elif event["text"].isdecimal():
                pids.add(int(event["text"]))
        if event["event"] == "node" and event["state"] == "loaded":
            waiting.discard(event["node"])
            pids.add(event["pid"])
        return not waiting

    replay.read_until(is_last, "everything running")
    found = {each.pid: each for each in replay.descendants()}
    assert set(pids) <= set(found), "whatever gets away stays below the guard"
    return list(found.values())


def ports_of(domain: int) -> list[str]:
    """Names of the ports of a domain that are in shared memory; those of its processes."""
    first = 7400 + 250 * domain
    numbers = {f"fastrtps_port{number}" for number in range(first, first + 250)}
    return [path.name for path in SHARED_MEMORY.iterdir() if path.name in numbers]


def test_nothing_outlives_a_supervisor_that_is_killed_alone(
    tmp_path: Path, ros_domain: int
) -> None:
    config = written(tmp_path, **configuration())
    with replaying(config, tmp_path / "logs") as replay:
        left = started(replay)
        assert len(left) > len(ESCAPES) + 2
        os.kill(replay.pid, signal.SIGKILL)
        replay.process.wait()
        psutil.wait_procs(left, timeout=LIMIT)
        left = alive(left)
        for each in left:
            each.kill()
    assert not left
    # Who sends to a port that was removed makes it anew, so they are left by those that end well.
    until(lambda: not ports_of(ros_domain), "an empty shared memory")


def test_containers_and_their_nodes_do_not_outlive_supervisor_and_guard_killed_together(
    tmp_path: Path,
) -> None:
    """The documented limit: what got away from its parent stays, and nothing else."""
    values = configuration()
    containers = values["containers"]
    containers += [
        {**each, "name": f"{each['name']}_mt", "container_type": kind, "composable_nodes": []}
        for each, kind in zip(containers, ("mt", "isolated_mt"), strict=True)
    ]
    containers.append({**containers[1], "name": "processes", "isolation": "process"})
    containers[-1]["composable_nodes"] = [node("talker_process")]
    values["nodes"].append({"name": "plain", "command": ["sleep", "600"]})
    config = written(tmp_path, **values)
    with replaying(config, tmp_path / "logs") as replay:
        everything = started(replay, "/talker_process")
        (guard,) = psutil.Process(replay.pid).children()
        direct = guard.children()
        containers = [each for each in direct if "component_container" in each.cmdline()[0]]
        assert len(containers) == len(values["containers"])
        nodes = [one for each in containers for one in each.children(recursive=True)]
        assert len(nodes) >= 2
        os.kill(replay.pid, signal.SIGKILL)
        os.kill(guard.pid, signal.SIGKILL)
        replay.process.wait()
        psutil.wait_procs([*direct, *nodes], timeout=LIMIT)
        left = alive(everything)
        for each in left:
            each.kill()
    sweep()  # killed containers leave shared memory, which the next run removes
    gone = [guard, *containers, *nodes]
    assert not [each for each in left if each in gone]
    assert len(left) <= ESCAPED, "one that ties itself to nobody, jobs, sessions, a fork, a daemon"
