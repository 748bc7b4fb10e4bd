"""Constructors that take their container down, that leave something in it, or never return."""

from __future__ import annotations

import socket
import subprocess
from pathlib import Path
from typing import Any

from tests.support.replay import COMMAND, Replay, replaying
from tests.support.waiting import until

CONFIG = """\
version: 1
containers:
  - name: c
    restart: {max_restarts: 1}
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}
      - package: play_launch_demo
        plugin: play_launch_demo::Crasher
        name: bad
        parameters: {in_constructor: true}
      - {package: play_launch_demo, plugin: "play_launch_demo::Listener", name: listener}
"""
AS_IT_SHOULD_BE = {"/talker": "loaded", "/bad": "load failed", "/listener": "loaded"}


def test_with_one_restart_allowed_the_others_are_loaded_in_the_end(tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text(CONFIG, encoding="utf-8")
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until_states(AS_IT_SHOULD_BE)
    reason = next(
        event["reason"]
        for event in replay.seen
        if event["event"] == "node" and event["state"] == "load failed"
    )
    assert "times while it was loaded" in reason
    assert "SIGSEGV" in reason


ISOLATED = """\
version: 1
containers:
  - name: c
    container_type: isolated
    isolation: {isolation}
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}}
      - package: play_launch_demo
        plugin: play_launch_demo::{plugin}
        name: bad
        parameters: {parameters}
"""


def command(replay: Replay, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [COMMAND, *arguments, "--session", str((replay.log_dir / "latest").resolve())],
        check=False,
        capture_output=True,
        text=True,
        timeout=100,
    )


def isolated(tmp_path: Path, plugin: str, isolation: str, **parameters: Any) -> Path:
    config = tmp_path / "c.yaml"
    text = ISOLATED.format(isolation=isolation, plugin=plugin, parameters=parameters)
    config.write_text(text, encoding="utf-8")
    return config


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
    config = isolated(tmp_path, "DiesOnce", "shared_memory", **options)
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until_states({"/talker": "loaded", "/bad": "load failed"})
        until(lambda: command(replay, "ps").returncode == 0, "a session that answers")
        command(replay, "reload", "/bad")
        stopping = replay.read_until(
            lambda event: (event["event"], event.get("kind")) == ("process", "stopping"), "a stop"
        )
        assert "its constructor died in this container before" in stopping["message"]
        assert "cannot bind the port" in stopping["message"]
        replay.read_until_states({"/talker": "loaded", "/bad": "loaded"})


def test_a_node_that_hangs_in_its_constructor_is_unloaded_and_loaded_again(tmp_path: Path) -> None:
    config = isolated(tmp_path, "SlowConstructor", "shared_memory", seconds=3600.0)
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until_states({"/talker": "loaded", "/bad": "loading"})
        until(lambda: command(replay, "ps").returncode == 0, "a session that answers")
        unloaded = command(replay, "unload", "/bad")
        assert (unloaded.returncode, unloaded.stdout) == (0, "/bad: unloaded\n"), unloaded
        assert command(replay, "load", "/bad", "--timeout", "1").returncode != 0
        replay.read_until_states({"/bad": "loading"})
        first = next(event["pid"] for event in replay.seen[::-1] if event.get("node") == "/bad")
        # As a new one, which hangs as well.
        assert command(replay, "reload", "/bad", "--timeout", "10").returncode != 0
        replay.read_until(
            lambda event: (
                event["event"] == "node"
                and (event["node"], event["state"]) == ("/bad", "loading")
                and event["pid"] not in {0, first}
            ),
            "another process",
        )
