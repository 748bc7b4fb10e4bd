"""Crashes and hangs in constructors, in destructors and while the system is stopped."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import pytest

from tests.support.replay import replaying, run
from tests.support.scenes import container, node, written


def test_with_one_restart_allowed_the_others_are_loaded_in_the_end(tmp_path: Path) -> None:
    bad = node("bad", "Crasher", parameters={"in_constructor": True})
    nodes = [node("talker"), bad, node("listener", "Listener")]
    one = container("c", *nodes, restart={"max_restarts": 1})
    with replaying(written(tmp_path, containers=[one]), tmp_path / "logs") as replay:
        states = {"/talker": "loaded", "/bad": "load failed", "/listener": "loaded"}
        replay.read_until_states(states)
    reason = replay.told(event="node", state="load failed")[0]["reason"]
    assert "times while it was loaded" in reason
    assert "SIGSEGV" in reason


def isolated(tmp_path: Path, plugin: str, **parameters: Any) -> Path:
    nodes = [node("talker"), node("bad", plugin, parameters=parameters)]
    how = {"container_type": "isolated", "isolation": "shared_memory"}
    return written(tmp_path, containers=[container("c", *nodes, **how)])


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        port: int = found.getsockname()[1]
        return port


def test_a_port_that_a_dead_constructor_had_bound_is_free_with_a_new_container(
    tmp_path: Path,
) -> None:
    marker = str(tmp_path / "has_died")
    options: dict[str, Any] = {"in": "port", "port": free_port(), "marker": marker}
    config = isolated(tmp_path, "DiesOnce", **options)
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until_states({"/talker": "loaded", "/bad": "load failed"})
        replay.until_operable()
        replay.ask("reload", "/bad")
        stopping = replay.until(event="process", kind="stopping")
        assert "its constructor died in this container before" in stopping["message"]
        assert "cannot bind the port" in stopping["message"]
        replay.read_until_states({"/talker": "loaded", "/bad": "loaded"})


def test_a_node_that_hangs_in_its_constructor_is_unloaded_and_loaded_again(tmp_path: Path) -> None:
    config = isolated(tmp_path, "SlowConstructor", seconds=3600.0)
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until_states({"/talker": "loaded", "/bad": "loading"})
        replay.until_operable()
        unloaded = replay.ask("unload", "/bad")
        assert (unloaded.returncode, unloaded.stdout) == (0, "/bad: unloaded\n"), unloaded
        assert replay.ask("load", "/bad", "--timeout", "1").returncode != 0
        replay.read_until_states({"/bad": "loading"})
        first = next(event["pid"] for event in replay.seen[::-1] if event.get("node") == "/bad")
        # As a new one, which hangs as well.
        assert replay.ask("reload", "/bad", "--timeout", "3").returncode != 0
        replay.read_until(
            lambda event: (
                event["event"] == "node"
                and (event["node"], event["state"]) == ("/bad", "loading")
                and event["pid"] not in {0, first}
            ),
            "another process",
        )


@pytest.mark.parametrize(("signal", "code"), [("SEGV", 1), ("ABRT", 1), ("KILL", 0), ("TERM", 0)])
def test_a_process_that_crashes_is_a_failure_and_one_that_is_killed_is_none(
    signal: str, code: int, tmp_path: Path
) -> None:
    faulty = f"trap 'kill -{signal} $$' INT; echo ready; while :; do sleep 0.05; done"
    nodes = [
        {"name": "faulty", "command": ["bash", "-c", faulty]},
        {
            "name": "last",
            "command": ["true"],
            "on_exit": "shutdown",
            "depends_on": [{"name": "faulty", "log": "ready"}],
        },
    ]
    # No time limit is to end it before its handler does.
    config = written(tmp_path, stop={"sigint": "60 s"}, nodes=nodes)
    done = run("replay", str(config), "--log-dir", str(tmp_path / "logs"))
    assert done.returncode == code, done.stdout
    assert (f"stopped: exited with signal {'11' if signal == 'SEGV' else '6'}" in done.stdout) == (
        code == 1
    )


@pytest.mark.parametrize(
    ("container_type", "how", "code", "text"),
    [
        ("isolated", "segv", 1, "crashed when stopped: /bad"),
        ("isolated_mt", "exception", 1, "crashed when stopped: /bad"),
        ("isolated", "kill", 0, ""),
        ("standard", "segv", 1, "stopped: exited with signal 11"),
        ("mt", "abrt", 1, "stopped: exited with signal 6"),
    ],
)
def test_a_destructor_that_faults_is_a_failure(
    container_type: str, how: str, code: int, text: str, tmp_path: Path
) -> None:
    bad = node("bad", "Crasher", parameters={"how": how, "in_destructor": True})
    loaded = [{"name": "bad"}, {"name": "good"}]
    last = {"name": "last", "command": ["true"], "on_exit": "shutdown", "depends_on": loaded}
    box = container("box", bad, node("good"), container_type=container_type)
    config = written(tmp_path, containers=[box], nodes=[last])
    done = run("replay", str(config), "--log-dir", str(tmp_path / "logs"))
    assert done.returncode == code, done.stdout
    assert text in done.stdout, done.stdout
    if container_type.startswith("isolated"):
        assert "lost" not in done.stdout, done.stdout
        assert ("/bad crashed: " in done.stdout) == (code == 1), done.stdout
