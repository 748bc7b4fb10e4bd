"""A system whose processes are born in control groups, and leaves none."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from play_launch.process.cgroups.group import Group
from tests.support.control_groups import control_group, group_of
from tests.support.replay import Replay, replaying, run
from tests.support.scenes import node, written
from tests.support.waiting import until


@pytest.fixture
def base() -> Iterator[Path]:
    with control_group() as path:
        yield path


def write(path: Path, base: Path, *, cgroups: dict[str, Any] | None = None, **keys: Any) -> Path:
    loading = {"container_type": "isolated", "cgroups": {"base_path": str(base), **(cgroups or {})}}
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return written(path, environment=environment, composable_node_loading=loading, **keys)


FAST = {"max_restarts": 5, "backoff": {"initial": "10 ms"}}
SYSTEM: dict[str, Any] = {
    "containers": [
        {"name": "shared", "composable_nodes": [node("a"), node("b")]},
        {"name": "apart", "isolation": "process", "composable_nodes": [node("c")]},
        {"name": "together", "container_type": "standard", "composable_nodes": [node("d")]},
    ],
    # Its child is in a session of its own, where nothing but the group is known of it.
    "nodes": [{"name": "shell", "command": ["sh", "-c", "setsid sleep 600 & wait"]}],
}


EVERYTHING = ("/shared", "/a", "/b", "/apart", "/c", "/together", "/d", "/shell")


def sessions(base: Path) -> list[Path]:
    return [each for each in base.iterdir() if each.is_dir()]


def test_processes_start_in_leaves_and_no_group_is_left(base: Path, tmp_path: Path) -> None:
    config = write(tmp_path / "a.yaml", base, cgroups={"enabled": True}, **SYSTEM)
    with replaying(config, tmp_path / "log") as replay:
        pids = until_up(replay, *EVERYTHING)
        (session,) = sessions(base)
        inside = {
            name: group_of(pid).partition(f"{session.name}/")[2] for name, pid in pids.items()
        }
        # The number of the attempt follows the name of a node.
        assert {name: group.rstrip("0123456789") for name, group in inside.items()} == {
            "/shared": "shared/container",
            "/a": "shared/a.",
            "/b": "shared/b.",
            "/apart": "apart/container",
            "/c": "apart/c.",
            "/together": "together",
            "/d": "together",
            "/shell": "shell",
        }
        rows = {row["name"]: row for row in json.loads(replay.ask("ps", "--json").stdout)}
        # A node without a process of its own is in the group of its container.
        assert {name for name, row in rows.items() if row["cgroup"] is None} == {"/d"}
        assert rows["/shared"]["cgroup"]["cpu_seconds"] > rows["/a"]["cgroup"]["cpu_seconds"] > 0
        # A node that comes back is born in a group of its own, and the old one goes.
        os.kill(pids["/a"], signal.SIGKILL)
        again = until_up(replay, "/a")["/a"]
        first, second = inside["/a"], group_of(again).partition(f"{session.name}/")[2]
        assert second != first
        assert second.startswith("shared/a.")
        until(lambda: not (session / first).exists(), what="the group of the dead node is removed")
        assert group_of(pids["/shared"]).endswith("shared/container")
        sleeper = [pid for pid in pids_in(session / "shell") if pid != pids["/shell"]]
        assert len(sleeper) == 1
    assert not sessions(base)
    assert not Path(f"/proc/{sleeper[0]}").exists()


def pids_in(group: Path) -> list[int]:
    return [int(pid) for pid in (group / "cgroup.procs").read_text().split()]


def test_the_groups_of_a_killed_supervisor_are_removed(base: Path, tmp_path: Path) -> None:
    config = write(tmp_path / "a.yaml", base, cgroups={"enabled": True}, **SYSTEM)
    with replaying(config, tmp_path / "log") as replay:
        until_up(replay, *EVERYTHING)
        (session,) = sessions(base)
        os.kill(replay.pid, signal.SIGKILL)
        replay.process.wait()
        # By its guard, with the process that left its session, too.
        until(lambda: not session.exists(), "the removal of its groups")


def test_changes_of_groups_from_outside_lose_nothing(base: Path, tmp_path: Path) -> None:
    shell = {**SYSTEM["nodes"][0], "on_exit": "restart", "restart": FAST}
    config = write(
        tmp_path / "a.yaml",
        base,
        cgroups={"enabled": True},
        containers=[{"name": "shared", "restart": FAST, "composable_nodes": [node("a")]}],
        nodes=[shell],
    )
    with replaying(config, tmp_path / "log") as replay:
        pids = until_up(replay, "/shared", "/a", "/shell")
        (session,) = sessions(base)
        # Killed by its group, it is brought back in one.
        (session / "shell" / "cgroup.kill").write_text("1")
        pids |= until_up(replay, "/shell")
        until(lambda: pids["/shell"] in pids_in(session / "shell"), "the new group of the process")
        # Moved out of their groups, which are removed.
        elsewhere = Group(base / "elsewhere")
        elsewhere.make()

        def are_removed() -> bool:
            elsewhere.move_here(Group(session).processes())  # they may fork meanwhile
            return Group(session).remove()

        until(are_removed, "the removal of all groups")
        os.kill(pids["/a"], signal.SIGKILL)
        pids |= until_up(replay, "/a")
        os.kill(pids["/shell"], signal.SIGKILL)
        pids |= until_up(replay, "/shell")
        # Each is born in one that was made anew.
        (restored,) = (session / "shared").glob("a.*")
        until(lambda: pids["/a"] in pids_in(restored), "the new group of the node")
        until(lambda: pids["/shell"] in pids_in(session / "shell"), "that of the process")
    assert not sessions(base) or sessions(base) == [elsewhere.path]
    assert not elsewhere.processes(), "nothing of it is left, wherever it was"


def until_up(replay: Replay, *names: str) -> dict[str, int]:
    """Wait until each is loaded, or started, from now on."""
    return {name: event["pid"] for name, event in replay.read_until_up(*names).items()}


def test_required_groups_that_there_are_not_end_the_run(tmp_path: Path) -> None:
    config = write(
        tmp_path / "a.yaml", tmp_path, cgroups={"enabled": True, "required": True}, **SYSTEM
    )
    ended = run("replay", config, "--log-dir", tmp_path / "log")
    assert ended.returncode == 2
    assert "is not in the hierarchy of cgroup v2" in ended.stderr or "no hierarchy" in ended.stderr
    assert "; fix: " in ended.stderr
