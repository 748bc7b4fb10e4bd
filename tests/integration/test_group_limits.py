"""Limits of control groups hold for what `replay` runs, where the kernel has the controllers.

`tests/guest` runs this in a machine that has them.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.figures import Figures
from play_launch.cli.run import GroupTotals
from play_launch.postmortem.past_session import PastSession
from play_launch.process.cgroups.group import Group
from play_launch.process.cgroups.session_groups import own_hierarchy
from play_launch.process.cgroups.usage import group_of
from play_launch.supervisor.events import GroupSample
from tests.support.control_groups import control_group
from tests.support.replay import Replay, replaying
from tests.support.scenes import container, node, written

NEEDED = {"cpu", "cpuset", "memory", "pids"}
FILL = "import os; os.write(1, b'begun\\n'); data = b'x' * (200 << 20)"
RATE = 1000.0
PLACES = {"first": 0, "second": 3, "apart": 6}
"""Of what each ControlLoop leaves: its pid, the number of its beats, the periods without one."""
WINDOW = 2.0
"""Seconds."""
WINDOWS = 45
"""The host of a virtual machine may have no time for it, and then no process in it has."""
LEAST = 10.0
"""Beats a second of one that has nothing to do with the others."""


@pytest.fixture
def base() -> Iterator[Path]:
    with control_group() as path:
        there = (own_hierarchy()[0] / "cgroup.controllers").read_text().split()
        if missing := NEEDED - set(there):
            pytest.skip(f"there are no controllers {', '.join(sorted(missing))}")
        yield path


def system(base: Path, environment: dict[str, str]) -> dict[str, Any]:
    first, second, apart = (
        node(name, "ControlLoop", parameters={"figures": place, "samples": 0, "rate": RATE})
        for name, place in PLACES.items()
    )
    second["resources"] = {"cpuset": "1", "io_weight": 50}
    half = {"cpu_max": "50 %"}
    greedy = node("greedy", "Greedy", parameters={"threads": 1}, resources=half)
    return {
        "version": 1,
        "environment": {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **environment},
        "record": {"ros": False},
        "composable_node_loading": {
            "container_type": "isolated",
            "cgroups": {"base_path": str(base)},
        },
        "containers": [
            container("lab", greedy, first, second),
            container("other", apart),
        ],
        "nodes": [
            {
                "name": "hungry",
                "command": [sys.executable, "-S", "-c", FILL],
                "resources": {"memory_max": "64 MiB"},
                "on_exit": "restart",
                "restart": {"max_restarts": 1, "backoff": {"initial": "10 ms"}},
            },
            {
                "name": "alone",
                "command": ["sh", "-c", "echo begun; sleep 600 & wait"],
                "resources": {"pids_max": 1},
            },
        ],
    }


def until_all_is_there(replay: Replay) -> dict[str, int]:
    """Wait until the nodes are loaded, and the process is given up; the pids of the nodes."""
    pids: dict[str, int] = {}
    has_given_up = False

    def complete(event: dict[str, Any]) -> bool:
        nonlocal has_given_up
        if event["event"] == "node" and event["state"] == "loaded":
            pids[event["node"]] = event["pid"]
        if event["event"] == "process" and event["name"] == "/hungry":
            has_given_up = has_given_up or event["kind"] == "gave_up"
        return len(pids) == 4 and has_given_up

    replay.read_until(complete, "all")
    return pids


def measured(greedy: Group, figures: Figures) -> tuple[float, dict[str, float]]:
    """Percent of a CPU that a group used for a while, and beats a second meanwhile."""
    before = {name: figures[place + 1] for name, place in PLACES.items()}
    used, began = greedy.numbers("cpu.stat")["usage_usec"], time.monotonic()
    time.sleep(WINDOW)
    used, elapsed = greedy.numbers("cpu.stat")["usage_usec"] - used, time.monotonic() - began
    beats = {name: (figures[PLACES[name] + 1] - count) / elapsed for name, count in before.items()}
    return used / 1e4 / elapsed, beats


def test_limits_hold_and_neighbours_go_on(base: Path, tmp_path: Path) -> None:
    config = tmp_path / "a.yaml"
    with Figures(9) as figures:
        written(config, **system(base, figures.environment))
        with replaying(config, tmp_path / "log") as replay:
            pids = until_all_is_there(replay)
            greedy, second = group_of(pids["/greedy"]), group_of(pids["/second"])
            assert greedy is not None
            assert second is not None
            seen = []
            for _ in range(WINDOWS):
                share, beats = measured(greedy, figures)
                seen.append((round(share, 1), {name: round(each) for name, each in beats.items()}))
                assert share < 55, seen
                # As often as one in a container of its own: its neighbour's end of time stops none.
                goes_on = min(beats["first"], beats["second"]) > 0.8 * beats["apart"] > LEAST
                if share > 45 and goes_on:
                    break
            print(seen)
            assert share > 45, seen
            assert goes_on, seen
            allowed = Path(f"/proc/{pids['/second']}/status").read_text()
            assert "\nCpus_allowed_list:\t1\n" in allowed
            assert "\nCpus_allowed_list:\t1\n" not in Path("/proc/self/status").read_text()
            logged = "".join(each["message"] for each in replay.seen if each["event"] == "log")
            if weight := second.text("io.weight"):
                assert weight == "default 50\n"
                assert "io.weight" not in logged
            else:
                assert "io.weight cannot be set to 50" in logged
    ends = [
        event
        for event in replay.seen
        if event["event"] == "process" and event["name"] == "/hungry" and event["signal"] == 9
    ]
    assert [event["kind"] for event in ends] == ["exited", "exited"]
    killed = "killed by the kernel: memory.max 64 MiB of its control group"
    assert all(killed in event["message"] for event in ends), ends
    (alone,) = (
        event
        for event in replay.seen
        if event["event"] == "process" and (event["name"], event["kind"]) == ("/alone", "exited")
    )
    assert re.search(
        "exited with status [0-9]+: pids_max 1 of its control group was reached once; fix: a "
        "larger one$",
        alone["message"],
    )
    in_the_recording(replay)


def in_the_recording(replay: Replay) -> None:
    totals = GroupTotals()
    for happened in PastSession(replay.bag).events():
        if isinstance(happened.event, GroupSample):
            totals.add(happened.event)
    found = {key: total for (_, key), total in totals.get().items()}
    # Of both processes, one after the other.
    assert found["/hungry"].oom_kills == 2
    greedy = found["/lab:/greedy"]
    assert greedy.throttled_periods > 0
    assert greedy.throttled_seconds > 0
    assert 0 < greedy.cpu_seconds < found["/lab"].cpu_seconds
