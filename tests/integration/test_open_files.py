"""A system that needs more files in its supervisor than the user's soft limit allows."""

from __future__ import annotations

import resource
import sys
from pathlib import Path
from typing import Any

import psutil

from play_launch.process.open_files import ENOUGH
from tests.support.replay import COMMAND, replaying
from tests.support.scenes import container, node, written

SOFT = 128
SLEEPERS = 60
"""Each takes three descriptors of the supervisor."""
LIMITED = (
    "import os, resource, sys; "
    "_, hard = resource.getrlimit(resource.RLIMIT_NOFILE); "
    f"resource.setrlimit(resource.RLIMIT_NOFILE, ({SOFT}, hard)); "
    "os.execv(sys.argv[1], sys.argv[1:])"
)


def system() -> dict[str, Any]:
    names = [f"sleeper_{number}" for number in range(SLEEPERS)]
    nodes: list[dict[str, Any]] = [{"name": name, "command": ["sleep", "1000"]} for name in names]
    late = [{"name": name, "condition": "started"} for name in names]
    nodes.append({"name": "limit", "command": ["sh", "-c", "ulimit -n"], "depends_on": late})
    # Their channels have numbers above the limit by then.
    containers = [
        container(kind, node(f"in_{kind}"), container_type=kind, depends_on=late)
        for kind in ("standard", "isolated")
    ]
    return {"containers": containers, "nodes": nodes}


def soft_limit(pid: int) -> int:
    return resource.prlimit(pid, resource.RLIMIT_NOFILE)[0]


def test_the_supervisor_may_open_more_and_nodes_as_many_as_the_user(tmp_path: Path) -> None:
    config = written(tmp_path, **system())
    program = (sys.executable, "-c", LIMITED, str(COMMAND))
    with replaying(config, tmp_path / "logs", program=program) as replay:
        states: dict[str, str] = {}
        printed: list[str] = []

        def done(event: dict[str, Any]) -> bool:
            if event["event"] == "node":
                states[event["node"]] = event["state"]
            if event["event"] == "output" and event["process"] == "/limit":
                printed.append(event["text"])
            return bool(printed) and list(states.values()).count("loaded") == 2

        replay.read_until(done, "two nodes and a limit")
        assert printed == [str(SOFT)]
        hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
        assert soft_limit(replay.pid) == (
            ENOUGH if hard == resource.RLIM_INFINITY else min(hard, ENOUGH)
        )
        assert psutil.Process(replay.pid).num_fds() > SOFT
        for name in ("/standard", "/isolated"):
            assert soft_limit(replay.told(name=name, kind="started")[0]["pid"]) == SOFT
