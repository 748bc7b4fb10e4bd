"""What is declared and not there at the end, through the real command."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import pytest
from composition_interfaces.srv import UnloadNode

from tests.support.replay import Replay, replaying
from tests.support.ros import Probe

CONFIG = """\
version: 1
duration: 12 s
composable_node_loading:
  restart: {{backoff: {{initial: 100 s, maximum: 100 s}}}}
containers:
  - name: c
    container_type: {kind}
    composable_nodes:
      - {{package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}}
      - {{package: play_launch_demo, plugin: "play_launch_demo::Listener", name: listener}}
"""


def loaded(replay: Replay) -> dict[str, dict[str, Any]]:
    """Wait for both nodes; their events by name."""
    found: dict[str, dict[str, Any]] = {}

    def both(event: dict[str, Any]) -> bool:
        if (event["event"], event.get("kind")) == ("component", "loaded"):
            found[event["full_node_name"]] = event
        return len(found) == 2

    replay.read_until(both, "both nodes loaded")
    return found


def unloaded(replay: Replay, node: str) -> dict[str, Any]:
    return next(
        event
        for event in replay.seen
        if event["event"] == "node" and (event["node"], event["state"]) == (node, "unloaded")
    )


@pytest.mark.parametrize("kind", ["standard", "isolated"])
def test_a_node_that_somebody_else_unloads(tmp_path: Path, kind: str) -> None:
    config = tmp_path / "c.yaml"
    config.write_text(CONFIG.format(kind=kind), encoding="utf-8")
    with replaying(config, tmp_path / "logs") as replay:
        talker = loaded(replay)["/talker"]
        with Probe() as probe:
            request = UnloadNode.Request(unique_id=talker["unique_id"])
            assert probe.call(UnloadNode, "/c/_container/unload_node", request).success
        replay.read_all()
    assert replay.seen[-1]["exit_code"] == replay.process.returncode == 3
    assert unloaded(replay, "/talker")["reason"] == "not at the supervisor's request"
    (container,) = replay.seen[-1]["containers"]
    assert (container["loaded"], container["unloaded"]) == (1, ["/talker"])


def test_a_container_that_somebody_else_ends_in_order(tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text(CONFIG.format(kind="standard"), encoding="utf-8")
    with replaying(config, tmp_path / "logs") as replay:
        os.kill(loaded(replay)["/talker"]["pid"], signal.SIGTERM)
        replay.read_all()
    assert replay.seen[-1]["exit_code"] == replay.process.returncode == 3
    exited = next(
        event for event in replay.seen if event["event"] == "process" and event["kind"] == "exited"
    )
    assert (exited["exit_code"], exited["signal"]) == (0, 0)
    (container,) = replay.seen[-1]["containers"]
    assert container["state"] == "backoff"


def with_quitter(kind: str) -> str:
    return CONFIG.format(kind=kind).replace("Listener", "Quitter")


def test_an_isolated_node_that_shuts_the_ros_context_down(tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text(with_quitter("isolated"), encoding="utf-8")
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_all()
    assert replay.seen[-1]["exit_code"] == replay.process.returncode == 3
    assert "context" in unloaded(replay, "/listener")["reason"]
    (container,) = replay.seen[-1]["containers"]
    assert (container["loaded"], container["unloaded"]) == (1, ["/listener"])


@pytest.mark.parametrize("kind", ["standard", "mt"])
def test_a_node_that_shuts_the_ros_context_of_all_down(tmp_path: Path, kind: str) -> None:
    config = tmp_path / "c.yaml"
    config.write_text(with_quitter(kind), encoding="utf-8")
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_all()
    assert replay.seen[-1]["exit_code"] == replay.process.returncode == 3
    starts = [each for each in replay.seen if each.get("kind") == "started"]
    assert len(starts) == 1, "it was started again"
    reasons = [each["error_message"] for each in replay.seen if each.get("kind") == "unloaded"]
    assert reasons
    assert all("/listener shut the ROS context down" in reason for reason in reasons)
    (container,) = replay.seen[-1]["containers"]
    assert container["state"] == "stopped"
    stops = [
        each
        for each in replay.seen
        if each["event"] == "container" and each.get("state") == "stopped"
    ]
    assert "a node shut its ROS context down" in stops[-1]["reason"]
