"""A supervisor that is killed leaves nothing behind, whatever its nodes did to get away."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import psutil
import yaml

from tests.process.test_guard import ESCAPES, escaping
from tests.support.replay import Replay, alive, replaying

LIMIT = 1.0
"""Seconds from the death of the supervisor to that of everything else."""


def talker(name: str) -> dict[str, str]:
    return {"package": "play_launch_demo", "plugin": "play_launch_demo::Talker", "name": name}


def configuration() -> dict[str, Any]:
    kinds = ("standard", "isolated")
    return {
        "version": 1,
        "containers": [
            {"name": kind, "container_type": kind, "composable_nodes": [talker(f"talker_{kind}")]}
            for kind in kinds
        ],
        "nodes": [{"name": how.replace(" ", "_"), "command": escaping(how)} for how in ESCAPES],
    }


def started(replay: Replay) -> list[psutil.Process]:
    """Wait until everything runs and has let loose what gets away; give all of it."""
    waiting = {f"/{how.replace(' ', '_')}" for how in ESCAPES} | {"/talker_standard"}
    waiting |= {"/talker_isolated"}
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


def test_nothing_outlives_a_supervisor_that_is_killed_alone(tmp_path: Path) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(yaml.safe_dump(configuration()), encoding="utf-8")
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


def test_an_orderly_stop_leaves_nothing_either(tmp_path: Path) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(yaml.safe_dump(configuration()), encoding="utf-8")
    with replaying(config, tmp_path / "logs") as replay:
        left = started(replay)
        os.kill(replay.pid, signal.SIGINT)
        replay.read_all()
        assert replay.process.returncode == 128 + signal.SIGINT
        assert not alive(left)
