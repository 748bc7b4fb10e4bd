"""A replay with the graph daemon: it serves while the system runs, and records the graph."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from play_launch.graph_daemon.contract import DaemonAddress, daemon_address
from play_launch.graph_daemon.port import OwnerKind, find_owner, stop_daemon
from tests.graph_daemon.occupants import occupied
from tests.support.replay import replaying, run

CONFIG = """
version: 1
graph_daemon: {wanted}
containers:
  - name: chat
    composable_nodes:
      - {{package: play_launch_demo, plugin: play_launch_demo::Talker, name: talker}}
"""
NODE = """
import sys, rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
_, name, *words = sys.argv
rclpy.init()
node = rclpy.create_node(name)
kept, dies = [], []
for word in words:
    topic, _, reliability = word.lstrip("!+-").partition(":")
    qos = QoSProfile(depth=1, reliability=ReliabilityPolicy(int(reliability)))
    if word.startswith("!"):
        # Die when the other has discovered what this one publishes, and a while later.
        dies.append(topic)
    elif word.startswith("+"):
        kept.append(node.create_publisher(String, topic, qos))
    else:
        kept.append(node.create_subscription(String, topic, lambda _: None, qos))
while not (dies and kept[0].get_subscription_count()):
    rclpy.spin_once(node, timeout_sec=0.1)
for _ in range(50):
    rclpy.spin_once(node, timeout_sec=0.1)
sys.exit(3)
"""


@pytest.fixture
def address() -> Iterator[DaemonAddress]:
    """Where the daemon serves, which is stopped afterwards."""
    yield daemon_address()
    stop_daemon(daemon_address())


def test_the_graph_is_served_and_recorded(address: DaemonAddress, tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(CONFIG.format(wanted="true"))
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until(
            lambda event: event["event"] == "graph" and "/talker" in event["appeared"],
            "the talker in the graph",
        )
        replay.process.send_signal(signal.SIGINT)
        summary = replay.read_all()[-1]
        assert summary["exit_code"] == 128 + signal.SIGINT
    # Other sessions may use it.
    assert find_owner(address).kind is OwnerKind.OURS
    with AnyReader([replay.bag]) as reader:
        recorded: list[Any] = [
            reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages()
            if connection.topic == "/play_launch/graph"
        ]
    assert any("/talker" in message.appeared for message in recorded)
    assert all(message.nodes >= len(message.appeared) for message in recorded)


@pytest.mark.usefixtures("address")
def test_what_does_not_connect_in_the_graph_is_explained(tmp_path: Path) -> None:
    """Nodes of rclpy, one of which ends: what they publish and subscribe to is in the recording."""
    program = tmp_path / "node.py"
    program.write_text(NODE, encoding="utf-8")
    nodes = [
        {"name": name, "command": [sys.executable, str(program), name, *words]}
        for name, *words in (
            ("lidar", "+scan:2", "+lidar/points:1"),
            ("slam", "-scan:1", "-points:1", "-joy:1", "-odom:1"),
            ("wheels", "+odom:1", "!-odom:1"),
            ("viewer", "-scan:2"),
        )
    ]
    config = tmp_path / "robot.yaml"
    values = {"version": 1, "graph_daemon": True, "duration": "20 s", "nodes": nodes}
    config.write_text(json.dumps(values), encoding="utf-8")
    with replaying(config, tmp_path / "logs") as replay:
        events = replay.read_all()
    assert any(event["event"] == "graph" and event["endpoints_appeared"] for event in events)
    explained = run("explain", replay.bag, code=1).stdout
    assert explained.count("QoS on ") == explained.count("QoS on /scan is incompatible") == 1
    assert (
        "Cause: reliability: /lidar offers best_effort, /slam requests reliable; to change: "
        "request best_effort in /slam."
    ) in explained
    assert "/slam subscribed to /points, which had no publisher until the end" in explained
    assert "did you mean /lidar/points? It has the same type, /lidar publishes it" in explained
    assert "/wheels left /odom without a publisher until the end" in explained
    assert "Subscriptions had no publisher until the end" in explained
    assert "/joy (/slam)" in explained


@pytest.mark.parametrize(
    "occupant",
    [("impostor",), ("silent",)],
    ids=["another program", "a daemon that hangs"],
)
def test_the_system_waits_for_no_owner_of_the_port(
    occupant: tuple[str, ...], tmp_path: Path
) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(
        "{version: 1, graph_daemon: true, record: {ros: false}, "
        "nodes: [{name: patient, command: [sleep, infinity]}]}"
    )
    kind, *words = occupant
    with (
        occupied(kind, daemon_address().port, *words) as owner,
        replaying(config, tmp_path / "logs") as replay,
    ):
        replay.read_until(lambda event: event["event"] == "process", "a process")
        if kind == "impostor":
            replay.read_until(
                lambda event: event["event"] == "log" and "no graph daemon" in event["message"],
                "a warning",
            )
        replay.process.send_signal(signal.SIGINT)
        assert replay.read_all()[-1]["exit_code"] == 128 + signal.SIGINT
        assert owner.poll() is None


def test_without_the_wish_there_is_no_daemon(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(CONFIG.format(wanted="false"))
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until(
            lambda event: event["event"] == "node" and event["state"] == "loaded", "the talker"
        )
        assert find_owner(daemon_address()).kind is OwnerKind.FREE
        replay.process.send_signal(signal.SIGINT)
        assert "graph" not in {event["event"] for event in replay.read_all()}
