"""Processes get from the kernel what `resources` says, and what it refuses is reported."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import signal
import sys
from pathlib import Path
from typing import Any

import psutil
import pytest

from play_launch.config.resources import IoClass, IoPriority, Scheduler, SchedulerPolicy
from play_launch.process.open_files import ENOUGH
from play_launch.process.resources import HeldResources, held_resources
from tests.support import scenes
from tests.support.replay import COMMAND, Replay, replaying
from tests.support.scenes import node, written

CPU = min(os.sched_getaffinity(0))
NICE = [min(os.getpriority(os.PRIO_PROCESS, 0) + step, 19) for step in range(5)]
"""Our own nice value, and higher ones, which need no privilege."""
FIFO = {"scheduler": {"policy": "fifo", "priority": 20}}
NO_RIGHTS = (
    "setpriv",
    "--bounding-set=-sys_nice,-sys_resource,-ipc_lock,-sys_admin",
    "--inh-caps=-sys_nice,-sys_resource,-ipc_lock,-sys_admin",
)
"""Runs a program that the kernel refuses what takes a right."""


def may_be_real_time() -> bool:
    """Whether processes that we start may ask for real-time scheduling."""
    if (pid := os.fork()) == 0:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(21))
        except PermissionError:
            os._exit(1)
        os._exit(0)
    return os.waitpid(pid, 0)[1] == 0


def container(name: str, *nodes: dict[str, Any], **more: Any) -> dict[str, Any]:
    return scenes.container(name, *nodes, **{"container_type": "isolated", **more})


def write(path: Path, **keys: Any) -> Path:
    return written(path, environment={"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, **keys)


def held(pid: int, *limits: str) -> HeldResources:
    found = held_resources(pid, limits)
    assert found is not None
    return found


def threads(pid: int) -> dict[int, tuple[str, HeldResources]]:
    """The threads of a process, with their names; they have resources like processes."""
    return {
        int(task.name): ((task / "comm").read_text().strip(), held(int(task.name)))
        for task in Path("/proc", str(pid), "task").iterdir()
    }


def warnings(replay: Replay) -> list[str]:
    return [
        event["message"]
        for event in replay.seen
        if event["event"] == "log" and event["level"] >= 30 and "; fix: " in event["message"]
    ]


def test_everything_is_read_back(tmp_path: Path) -> None:
    config = write(
        tmp_path / "config.yaml",
        composable_node_loading={"resources": {"nice": NICE[2]}},
        containers=[
            container(
                "c_shared",
                node("given", resources={"cpu_affinity": [CPU], "io_priority": "best_effort:1"}),
                node(
                    "own", resources={"nice": NICE[3], "rlimits": {"cpu": "1 h", "fsize": "1 GB"}}
                ),
                node("last", resources={"scheduler": {"policy": "batch"}}),
                container_type="isolated_mt",
                resources={"nice": NICE[1], "oom_score_adj": 210, "rlimits": {"nofile": 4000}},
            ),
            container(
                "c_apart",
                node("alone", resources={"oom_score_adj": 320, "rlimits": {"as": "8 GiB"}}),
                isolation="process",
            ),
        ],
        nodes=[
            {
                "name": "sleeper",
                "command": ["sleep", "600"],
                "resources": {
                    "nice": NICE[4],
                    "scheduler": {"policy": "idle"},
                    "cpu_affinity": str(CPU),
                    "io_priority": "idle",
                    "oom_score_adj": 400,
                    "rlimits": {"nofile": "100:200", "core": 0},
                },
            }
        ],
    )
    with replaying(config, tmp_path / "log") as replay:
        names = ("/given", "/own", "/last", "/alone", "/sleeper", "/c_shared", "/c_apart")
        pids = {name: event["pid"] for name, event in replay.read_until_up(*names).items()}
        sleeper = held(pids["/sleeper"], "nofile", "core")
        assert sleeper.nice == NICE[4]
        assert sleeper.scheduler == Scheduler(SchedulerPolicy.IDLE)
        assert sleeper.cpu_affinity == (CPU,)
        assert sleeper.io_priority == IoPriority(IoClass.IDLE)
        assert sleeper.oom_score_adj == 400
        assert sleeper.rlimits == {"nofile": (100, 200), "core": (0, 0)}

        shared = held(pids["/c_shared"], "nofile")
        assert (shared.nice, shared.oom_score_adj) == (NICE[1], 210)
        assert shared.rlimits["nofile"] == (4000, 4000)

        # With every thread of the node: those of its executor were started by its first.
        given = threads(pids["/given"])
        assert len(given) >= 2
        for _, each in given.values():
            assert (each.nice, each.cpu_affinity) == (NICE[2], (CPU,))
            assert each.io_priority == IoPriority(IoClass.BEST_EFFORT, 1)
        own = held(pids["/own"], "cpu", "fsize")
        assert own.nice == NICE[3]
        assert own.rlimits == {"cpu": (3600, 3600), "fsize": (1e9, 1e9)}
        last = held(pids["/last"])
        assert (last.nice, last.scheduler.policy) == (NICE[2], SchedulerPolicy.BATCH)
        alone = held(pids["/alone"], "as")
        assert (alone.nice, alone.oom_score_adj) == (NICE[2], 320)
        assert alone.rlimits["as"] == (8 * 2**30, 8 * 2**30)
        assert held(pids["/c_apart"]).oom_score_adj != 320

        # A reload and a restart bring the same.
        os.kill(pids["/own"], signal.SIGKILL)
        assert held(replay.read_until_up("/own")["/own"]["pid"]).nice == NICE[3]
    assert not warnings(replay)


@pytest.mark.skipif(not may_be_real_time(), reason="real-time scheduling takes CAP_SYS_NICE")
def test_the_container_watches_over_real_time_nodes(tmp_path: Path) -> None:
    config = write(
        tmp_path / "config.yaml",
        containers=[
            container("c_all", node("calm"), node("urgent", resources=FIFO, depends_on=["calm"]))
        ],
    )
    with replaying(config, tmp_path / "log") as replay:
        up = replay.read_until_up("/c_all", "/calm", "/urgent")
        pids = {name: event["pid"] for name, event in up.items()}
        assert held(pids["/urgent"]).scheduler == Scheduler(SchedulerPolicy.FIFO, 20)
        assert held(pids["/calm"]).scheduler == Scheduler(SchedulerPolicy.OTHER)

        def above() -> dict[str, list[Scheduler]]:
            found: dict[str, list[Scheduler]] = {}
            for name, each in threads(pids["/c_all"]).values():
                found.setdefault(name, []).append(each.scheduler)
            return found

        watching = [Scheduler(SchedulerPolicy.FIFO, 21)]
        # The monitor, and the donors: also of the node that was there before.
        found = above()
        assert [found[name] for name in ("monitor", "calm", "urgent")] == [watching] * 3
        others = [each for name, some in found.items() if [*some] != watching for each in some]
        assert others
        assert set(others) == {Scheduler(SchedulerPolicy.OTHER)}

        os.kill(pids["/calm"], signal.SIGKILL)
        # Its donor was urgent from the beginning; it is not.
        assert held(replay.read_until_up("/calm")["/calm"]["pid"]).scheduler == Scheduler(
            SchedulerPolicy.OTHER
        )
    assert not warnings(replay)


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="setpriv is not installed")
def test_what_is_refused_is_reported_with_the_fix_and_runs_without(tmp_path: Path) -> None:
    config = write(
        tmp_path / "config.yaml",
        containers=[
            container(
                "c_all",
                node("urgent", resources=FIFO),
                node("first", resources={"nice": -20, "io_priority": "realtime:0"}),
                resources={"lock_memory": True, "oom_score_adj": -1000},
            )
        ],
        nodes=[
            {
                "name": "sleeper",
                "command": ["sleep", "600"],
                "resources": {
                    "rlimits": {"rtprio": 90, "memlock": "unlimited"},
                    "cpu_affinity": [CPU, 1023],
                },
            }
        ],
    )
    lowered = ("prlimit", "--rtprio=0", "--nice=0", "--memlock=65536")
    with replaying(
        config, tmp_path / "log", program=(*lowered, *NO_RIGHTS, str(COMMAND))
    ) as replay:
        replay.read_until_states({"/urgent": "loaded", "/first": "loaded"})
        # The other process may have been started last, but not that late.
        replay.read_until(
            lambda event: len(warnings(replay)) == 8 or event.get("text", "").endswith(": 50'"),
            "eight warnings",
        )
    told = "\n".join(sorted(warnings(replay)))
    for pattern in (
        r"^/urgent: scheduler is other, not fifo 20: .*; fix: LimitRTPRIO=20 .*docs/resources.md",
        r"^/first: nice is -?\d+, not -20: .*; fix: LimitNICE=-20 .*docs/resources.md",
        r"^/first: io_priority is .*, not realtime:0: .*; fix: AmbientCapabilities=CAP_SYS_NICE",
        r"^/c_all: its memory is not locked: .*; fix: LimitMEMLOCK=infinity",
        r"^/c_all: oom_score_adj is -?\d+, not -1000: .*; fix: OOMScoreAdjust=-1000",
        r"^/sleeper: rlimit rtprio is 0, not 90: .*; fix: LimitRTPRIO=90",
        r"^/sleeper: rlimit memlock is 65536, not unlimited: .*; fix: LimitMEMLOCK=infinity",
        rf"^/sleeper: cpu_affinity is {CPU}, not {CPU},1023: ",
    ):
        assert len(re.findall(pattern, told, re.MULTILINE)) == 1, (pattern, told)
    assert len(told.splitlines()) == 8


def test_apply_loads_again_whose_resources_changed(tmp_path: Path) -> None:
    def nodes(**resources: Any) -> list[dict[str, Any]]:
        box = container("c_box", node("kept"), node("changed", resources=resources))
        return [box]

    config = write(tmp_path / "before.yaml", containers=nodes(nice=NICE[1]))
    target = write(tmp_path / "after.yaml", containers=nodes(nice=NICE[2]))
    with replaying(config, tmp_path / "log") as replay:
        pids = {k: each["pid"] for k, each in replay.read_until_up("/kept", "/changed").items()}
        before = pids["/changed"]
        replay.until_operable()
        diff = replay.ask("diff", target, "--json")
        (step,) = json.loads(diff.stdout)["steps"]
        assert (step["name"], step["action"]) == ("/c_box:/changed", "reload")
        assert [each["path"] for each in step["changes"]] == ["resources.nice"]
        assert replay.ask("apply", target).returncode == 0
        after = replay.read_until_up("/changed")["/changed"]["pid"]
        assert after != before
        assert held(after).nice == NICE[2]
        assert held(pids["/kept"]).nice == NICE[0]


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
        scenes.container(kind, node(f"in_{kind}"), container_type=kind, depends_on=late)
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
