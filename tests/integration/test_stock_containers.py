"""Containers that are not our own and behave: the honest kind, and those that others start."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from std_msgs.msg import String

from tests.support.container import running_container
from tests.support.replay import Replay, recorded, replaying, run
from tests.support.ros import Probe
from tests.support.scenes import node, written
from tests.support.stock import (
    Double,
    has_components,
    install,
    rclcpp_container,
    running_double,
)

LIMIT = "180s"
"""Ends a run whose test waits in vain."""


def any_node(name: str, *faults: str) -> dict[str, Any]:
    parameters = {"parameters": {"faults": list(faults)}} if faults else {}
    return {"package": "any", "plugin": "any::Node", "name": name, **parameters}


def write(folder: Path, *containers: dict[str, Any], **keys: Any) -> Path:
    return written(folder, containers=list(containers), **keys)


def state(node: str, *states: str) -> Callable[[dict[str, Any]], bool]:
    """Whether an event tells that a node is in one of these states."""
    return lambda event: (
        event["event"] == "node" and event["node"] == node and event["state"] in states
    )


def told(replay: Replay, word: str) -> list[str]:
    """What the supervisor's log said with that word in it."""
    return [
        event["message"]
        for event in replay.seen
        if event["event"] == "log" and word in event["message"]
    ]


def listed(container: str) -> dict[str, int]:
    with Probe() as probe:
        return dict(probe.nodes(container))


HONEST = {
    "name": "honest",
    "container_type": "stock",
    "package": "play_launch_container",
    "composable_nodes": [
        node("talker", parameters={"rate": 50.0}, remappings={"chatter": "/said"}),
        node("listener", "Listener", remappings={"chatter": "/said"}),
        node("broken", "ThrowingConstructor"),
    ],
}


def test_real_components_are_loaded_talk_and_are_recorded(tmp_path: Path) -> None:
    config = write(tmp_path, HONEST)
    with replaying(config, tmp_path, "--duration", LIMIT) as replay:
        replay.read_until(state("/broken", "load failed"), "the failure")
        with Probe() as probe:
            heard = probe.collect(String, "/said", count=2, timeout=60)
        assert heard[0].data.startswith("Hello World")
        replay.process.terminate()
        replay.read_all()
    summary = replay.seen[-1]["containers"][0]
    assert (summary["loaded"], summary["failed"]) == (2, ["/broken"])
    (started,) = replay.told(event="process", kind="started")
    assert Path(started["command"][0]).name == "component_container"
    (ready,) = replay.told(event="process", kind="ready")
    assert ready["message"].startswith("stock, rmw_fastrtps_cpp, domain ")
    for topic in ("events", "states"):
        assert recorded(replay.bag, f"/play_launch/{topic}")


def test_a_node_that_another_program_unloads_is_reported(tmp_path: Path) -> None:
    config = write(tmp_path, HONEST)
    with replaying(config, tmp_path, "--duration", LIMIT) as replay:
        loaded = replay.read_until(state("/listener", "loaded"), "the node")
        replay.read_until(state("/broken", "load failed"), "the failure")
        with Probe() as probe:
            assert probe.unload(loaded["unique_id"], "/honest").success
        unloaded = replay.read_until(state("/listener", "unloaded"), "its end")
        assert "another program unloaded it" in unloaded["reason"]


def test_a_program_that_is_not_there_is_said_at_once(tmp_path: Path) -> None:
    config = write(
        tmp_path,
        {"name": "box", "container_type": "stock", "package": "nobody_has_this"},
    )
    result = run("replay", config, "--log-dir", tmp_path)
    assert result.returncode == 1
    assert "package nobody_has_this is not installed" in result.stdout


THEIRS = {"name": "theirs", "container_type": "stock", "attach": True}


@pytest.fixture(name="double")
def _double(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Double:
    double = install(tmp_path)
    for name, value in double.environment.items():
        monkeypatch.setenv(name, value)
    return double


def load(name: str) -> int:
    """Have another program load a node into /theirs."""
    with Probe() as probe:
        answer = probe.load("Node", package="any", container="/theirs", node_name=name)
    assert answer.success
    return int(answer.unique_id)


def test_attaching_refuses_names_that_are_there_loads_the_rest_and_unloads_only_that(
    tmp_path: Path, double: Double
) -> None:
    nodes = [any_node("there"), any_node("missing")]
    config = write(tmp_path, THEIRS | {"composable_nodes": nodes})
    with running_double(double) as container:
        there = load("there")
        stranger = load("stranger")
        with replaying(config, tmp_path, "--duration", LIMIT) as replay:
            refused = replay.read_until(state("/there", "load failed"), "the one that was there")
            replay.read_until(state("/missing", "loaded"), "the one that was missing")
            assert f"has a node of that name already (unique_id {there})" in refused["reason"]
            assert set(listed("/theirs")) == {"/there", "/stranger", "/missing"}
            replay.process.terminate()
            replay.read_all()
        assert listed("/theirs") == {"/there": there, "/stranger": stranger}
        assert container.poll() is None
    assert [name for name, _ in double.journal("construct")] == ["/there", "/stranger", "/missing"]


def test_an_attached_container_is_waited_for_again(tmp_path: Path, double: Double) -> None:
    config = write(tmp_path, THEIRS | {"composable_nodes": [any_node("one")]})
    with replaying(config, tmp_path, "--duration", LIMIT) as replay:
        with running_double(double):
            replay.read_until(state("/one", "loaded"), "the node")
        replay.read_until(state("/one", "lost"), "the loss")
        with running_double(double):
            replay.read_until(state("/one", "loaded"), "the node again")
        replay.read_until(state("/one", "lost"), "the second loss")
        messages = [e["message"] for e in replay.seen if e["event"] == "process"]
        assert any("services left the graph" in message for message in messages)
    assert len(double.journal("construct")) == 2


def test_a_container_that_was_killed_and_started_anew_at_once_gets_its_nodes_again(
    tmp_path: Path, double: Double
) -> None:
    """The services of the dead one are in the graph until its lease is over, or not any more."""
    config = write(tmp_path, THEIRS | {"composable_nodes": [any_node("one")]})
    with replaying(config, tmp_path, "--duration", LIMIT) as replay:
        with running_double(double) as container:
            replay.read_until(state("/one", "loaded"), "the node")
            container.kill()
            container.wait()
        with running_double(double):
            replay.read_until(state("/one", "lost"), "the loss")
            replay.read_until(state("/one", "loaded"), "the node again")
            messages = [e["message"] for e in replay.seen if e["event"] == "process"]
            noticed = ("it was restarted", "it is gone: its services left the graph")
            assert any(message.startswith(noticed) for message in messages)
    assert len(double.journal("construct")) == 2


def test_coming_and_going_is_bounded(tmp_path: Path, double: Double) -> None:
    container = THEIRS | {"composable_nodes": [any_node("one")], "restart": {"max_restarts": 1}}
    config = write(tmp_path, container)
    with replaying(config, tmp_path, "--duration", LIMIT) as replay:
        for _ in range(2):
            with running_double(double):
                replay.read_until(state("/one", "loaded"), "the node")
            replay.read_until(state("/one", "lost"), "the loss")
        replay.read_all()
        assert replay.process.returncode == 1
    assert told(replay, "/theirs is not started again")


def test_a_wait_for_an_attached_container_is_reported(tmp_path: Path) -> None:
    config = write(tmp_path, THEIRS | {"composable_nodes": [any_node("one")]})
    with replaying(config, tmp_path, "--duration", LIMIT) as replay:
        replay.until(
            event="log", message="waiting for /theirs: no container of that name is running"
        )


def test_a_run_that_ends_before_the_container_came_has_nodes_missing(tmp_path: Path) -> None:
    config = write(tmp_path, THEIRS | {"composable_nodes": [any_node("one")]}, duration="1 s")
    with replaying(config, tmp_path) as replay:
        replay.read_all()
        assert replay.process.returncode == 3


def test_a_container_is_let_go_in_time_though_it_does_not_unload(
    tmp_path: Path, double: Double
) -> None:
    nodes = [any_node("kept", "keep"), any_node("stuck", "hang")]
    config = write(tmp_path, THEIRS | {"composable_nodes": nodes}, stop={"ask": "1 s"})
    with running_double(double) as container:
        with replaying(config, tmp_path, "--duration", LIMIT) as replay:
            replay.read_until(state("/stuck", "loading"), "the load that hangs")
            replay.process.terminate()
            replay.read_all()
            assert told(replay, "not unloaded in time")
        assert container.poll() is None
        container.kill()  # its hanging constructor may keep it from ending in order


def test_our_own_container_can_be_attached_to_as_well(tmp_path: Path) -> None:
    nodes = [node("talker"), node("slow", "SlowConstructor", parameters={"seconds": 5.0})]
    config = write(
        tmp_path,
        THEIRS | {"composable_nodes": nodes, "loading_timeout": "1 s"},
    )
    with running_container(name="theirs", log=tmp_path / "log") as container:
        with replaying(config, tmp_path, "--duration", LIMIT) as replay:
            slow = replay.read_until(state("/slow", "loaded"), "the slow one")
            # It answers while it constructs, so that a list without the node means nothing.
            assert slow["attempt"] == 2
            assert not told(replay, "sent anew")
            replay.process.terminate()
            replay.read_all()
        assert listed("/theirs") == {}
        assert container.poll() is None


@pytest.fixture(name="_rclcpp")
def _needs_rclcpp() -> None:
    missing = []
    if rclcpp_container() is None:
        missing.append("component_container of rclcpp_components")
    if not has_components("composition"):
        missing.append("the package composition of ROS's demos")
    if missing:
        pytest.skip(f"not on this machine: {', '.join(missing)}")


@pytest.mark.usefixtures("_rclcpp")
@pytest.mark.parametrize(
    "executable", ["component_container", "component_container_mt", "component_container_isolated"]
)
def test_rclcpps_own_container_loads_the_demo_components(tmp_path: Path, executable: str) -> None:
    nodes = [
        {"package": "composition", "plugin": f"composition::{plugin}", "name": plugin.lower()}
        for plugin in ("Talker", "Listener", "Server")
    ]
    config = write(
        tmp_path,
        {
            "name": "real",
            "container_type": "stock",
            "executable": executable,
            "composable_nodes": [*nodes, any_node("nobody_has_it")],
        },
    )
    with replaying(config, tmp_path, "--duration", LIMIT) as replay:
        failed = replay.read_until(state("/nobody_has_it", "load failed"), "the failure")
        assert failed["reason"]
        with Probe() as probe:
            assert probe.collect(String, "/chatter", timeout=60)
        assert set(listed("/real")) == {"/talker", "/listener", "/server"}
        replay.process.terminate()
        replay.read_all()
    assert replay.seen[-1]["containers"][0]["loaded"] == 3


@pytest.mark.usefixtures("_rclcpp")
def test_rclcpps_own_container_comes_back_after_sigkill(tmp_path: Path) -> None:
    talker = {"package": "composition", "plugin": "composition::Talker", "name": "talker"}
    container = {"name": "real", "container_type": "stock", "composable_nodes": [talker]}
    with replaying(write(tmp_path, container), tmp_path, "--duration", LIMIT) as replay:
        first = replay.read_until(state("/talker", "loaded"), "the node")
        os.kill(first["pid"], 9)
        replay.read_until(state("/talker", "lost"), "the loss")
        again = replay.read_until(state("/talker", "loaded"), "the node again")
        assert again["pid"] != first["pid"]
