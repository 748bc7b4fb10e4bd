"""Managed (lifecycle) nodes, native ones and rclpy's, brought up by the installed command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support import scenes
from tests.support.replay import Replay, recorded, replaying, run
from tests.support.scenes import written

WAIT = ("wait", "--for", "active", "--json")
MANAGED_KIND = 3
RCLPY = """
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import Node, TransitionCallbackReturn

class Managed(Node):
    def on_configure(self, state):
        print("configured", flush=True)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state):
        super().on_activate(state)
        print("activated", flush=True)
        return TransitionCallbackReturn.SUCCESS

rclpy.init()
executor = SingleThreadedExecutor()
executor.add_node(Managed("python"))
executor.spin()
"""


def write(folder: Path, **document: Any) -> Path:
    return written(folder, record={"ros": False}, **document)


def node(name: str, **more: Any) -> dict[str, Any]:
    return scenes.node(name, "Managed", **{"autostart": "activate", **more})


WATCHED = scenes.node("watched", "Managed")


def container(*nodes: dict[str, Any], kind: str = "isolated") -> dict[str, Any]:
    return scenes.container("c", *nodes, container_type=kind)


def states(replay: Replay, name: str) -> list[str]:
    return [event["state"] for event in replay.told(event="managed", node=name)]


WAY = ["asked", "configuring", "activating", "active"]


def test_native_and_rclpy_nodes_become_active_and_what_waits_for_that_starts(
    tmp_path: Path,
) -> None:
    nodes = [
        {
            "name": "last",
            "command": ["true"],
            "depends_on": [
                {"name": name, "condition": "active"} for name in ("one", "python", "watched")
            ],
        },
        {
            "name": "python",
            "command": [sys.executable, "-c", RCLPY],
            "autostart": "activate",
        },
        {
            "name": "helper",
            "command": [sys.executable, "-c", HELPER],
            "depends_on": ["watched"],
        },
    ]
    containers = [container(node("one"), node("two", autostart="configure"), WATCHED)]
    config = write(tmp_path, containers=containers, nodes=nodes)
    with replaying(config, tmp_path / "logs") as replay:
        replay.until(kind="started", name="/last")
    assert states(replay, "/one")[:4] == WAY
    assert states(replay, "/python")[:4] == WAY
    assert states(replay, "/two")[:3] == ["asked", "configuring", "inactive"]
    assert states(replay, "/watched") == [], "only its helper changes its state"
    messages = recorded(replay.bag, "/play_launch/states")
    managed = [each for each in messages if each.kind == MANAGED_KIND and each.name == "/one"]
    assert [each.state for each in managed[:4]] == WAY
    assert managed[0].key == "/c:/one"


HELPER = """
import rclpy
from lifecycle_msgs.srv import ChangeState
rclpy.init()
node = rclpy.create_node("helper")
client = node.create_client(ChangeState, "/watched/change_state")
client.wait_for_service()
for transition in (1, 3):
    request = ChangeState.Request()
    request.transition.id = transition
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future)
    assert future.result().success
"""


@pytest.mark.parametrize("transition", ["configure", "activate"])
def test_a_transition_that_fails_is_reported_and_fails_what_waits(
    tmp_path: Path, transition: str
) -> None:
    nodes = [
        {
            "name": "late",
            "command": ["true"],
            "depends_on": [{"name": "one", "condition": "active"}],
            "on_exit": "shutdown",
        }
    ]
    containers = [container(node("one", parameters={"fails": transition}))]
    config = write(tmp_path, containers=containers, nodes=nodes)
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_all()
    assert replay.process.returncode == 1
    (failed,) = (event for event in replay.seen if event.get("state") == "failed")
    assert failed["reason"] == f"its transition {transition} failed"
    (late,) = (event for event in replay.seen if event.get("kind") == "gave_up")
    assert late["message"] == f"it waited for /one to be active: {failed['reason']}"
    explained = run("explain", replay.bag, code=1).stdout
    assert "/one in /c was not brought up as a managed node" in explained
    assert f"Cause: {failed['reason']}" in explained


def test_one_that_takes_too_long(tmp_path: Path) -> None:
    slow = node("one", parameters={"takes": 600.0}, transition_timeout="12 s")
    config = write(tmp_path, containers=[container(slow, kind="mt")])
    with replaying(config, tmp_path / "logs") as replay:
        failed = replay.until(event="managed", state="failed")
    assert failed["reason"] == "its transition configure took longer than 12 s"


def test_one_without_services_is_reported(tmp_path: Path) -> None:
    talker = scenes.node("talker", autostart="activate", transition_timeout="300 ms")
    config = write(tmp_path, containers=[container(talker)])
    with replaying(config, tmp_path / "logs") as replay:
        failed = replay.until(event="managed", state="failed")
    assert failed["reason"] == "the service /talker/get_state was not available within 0.3 s"


LOSES_FIRST_ANSWERS = """
import rclpy
from rclpy.lifecycle import LifecycleNode

def lose_the_first_answer_of(service):
    def lose(response, header):
        del service.send_response
    service.send_response = lose

rclpy.init()
node = LifecycleNode("python")
for service in node.services:
    if service.service_name.endswith("/get_state"):
        lose_the_first_answer_of(service)
rclpy.spin(node)
"""


def test_an_answer_that_is_lost_is_asked_for_again(tmp_path: Path) -> None:
    # A node whose middleware does not know us yet drops its answer.
    command = [sys.executable, "-c", LOSES_FIRST_ANSWERS]
    process = {"name": "python", "command": command, "autostart": "activate"}
    with replaying(write(tmp_path, nodes=[process]), tmp_path / "logs") as replay:
        replay.until(event="managed", node="/python", state="active")


def test_it_is_activated_again_after_a_crash(tmp_path: Path) -> None:
    config = write(tmp_path, containers=[container(node("one"), scenes.node("talker"))])
    with replaying(config, tmp_path / "logs") as replay:
        replay.until(event="managed", state="active")
        loaded = replay.told(event="node", node="/one", state="loaded")
        os.kill(loaded[-1]["pid"], 11)
        replay.until(event="node", node="/one", state="crashed")
        replay.until(event="managed", state="active")
    assert states(replay, "/one")[:9] == [*WAY, "absent", *WAY]


def test_waiting_ends_when_all_of_them_are_active(tmp_path: Path) -> None:
    """Nodes that we activate, and nodes that another program activates."""
    slow = node("slow", parameters={"takes": 0.5})
    helper: dict[str, Any] = {"name": "helper", "command": [sys.executable, "-c", HELPER]}
    helper["depends_on"] = [{"name": "slow", "condition": "active"}, "watched"]
    containers = [container(slow, WATCHED)]
    config = write(tmp_path, containers=containers, nodes=[helper])
    with replaying(config, tmp_path / "logs") as replay:
        replay.until(event="managed", node="/slow", state="asked")
        replay.until_operable()
        done = json.loads(replay.ask(*WAIT, code=0).stdout)
        assert done["reached"] is True
        assert {"/slow", "/watched"} <= set(done["names"])
        replay.until(event="managed", node="/slow", state="active")
        assert states(replay, "/slow")[:4] == WAY


def test_waiting_for_a_node_that_is_never_activated(tmp_path: Path) -> None:
    config = write(tmp_path, containers=[container(WATCHED)])
    with replaying(config, tmp_path / "logs") as replay:
        replay.until(event="node", node="/watched", state="loaded")
        replay.until_operable()
        early = replay.ask(*WAIT, "--timeout", "3", code=4)
        assert json.loads(early.stdout)["missing"] == ["/watched"]
        subprocess.run([sys.executable, "-c", HELPER], check=True, timeout=90)
        assert json.loads(replay.ask(*WAIT, code=0).stdout)["missing"] == []


def test_waiting_ends_with_the_reason_when_a_transition_fails(tmp_path: Path) -> None:
    config = write(tmp_path, containers=[container(node("one", parameters={"fails": "activate"}))])
    with replaying(config, tmp_path / "logs") as replay:
        replay.until(event="node", node="/one", state="loaded")
        replay.until_operable()
        failed = replay.ask(*WAIT, "--timeout", "60", code=1)
        assert "/one: its transition activate failed" in failed.stderr


def test_what_is_not_driven_any_more_has_no_lifecycle_state(tmp_path: Path) -> None:
    waits = [{"name": "one", "condition": "active"}]
    waiting = {"name": "late", "command": ["true"], "depends_on": waits}
    config = write(tmp_path, containers=[container(node("one"))], nodes=[waiting])
    with replaying(config, tmp_path / "logs") as replay:
        replay.ask(*WAIT, code=0)
        assert "Lifecycle: active" in replay.ask("status", "one", code=0).stdout
        # It goes on being watched.
        watched = scenes.node("one", "Managed")
        write(tmp_path, containers=[container(watched)], nodes=[waiting])
        replay.ask("apply", config, code=0)
        replay.until(event="managed", node="/one", state="absent")
        assert "Lifecycle" not in replay.ask("status", "one", code=0).stdout
