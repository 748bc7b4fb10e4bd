"""A replay with the graph daemon: it serves while the system runs, and records the graph."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader

from play_launch.graph_daemon.contract import daemon_address
from play_launch.graph_daemon.control.takeover import Kind, look
from tests.support.replay import replaying

CONFIG = """
version: 1
graph_daemon: {wanted}
containers:
  - name: chat
    composable_nodes:
      - {{package: play_launch_demo, plugin: play_launch_demo::Talker, name: talker}}
"""


def test_the_graph_is_served_and_recorded(tmp_path: Path) -> None:
    address = daemon_address()
    config = tmp_path / "robot.yaml"
    config.write_text(CONFIG.format(wanted="true"))
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until(lambda event: event["event"] == "process", "a process")
        # It was there before the first process.
        assert look(address).kind is Kind.OURS
        replay.read_until(
            lambda event: event["event"] == "graph" and "/talker" in event["appeared"],
            "the talker in the graph",
        )
        replay.process.send_signal(signal.SIGINT)
        summary = replay.read_all()[-1]
        assert summary["exit_code"] == 128 + signal.SIGINT
    assert look(address).kind is Kind.NOBODY
    with AnyReader([replay.bag]) as reader:
        recorded: list[Any] = [
            reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages()
            if connection.topic == "/play_launch/graph"
        ]
    assert any("/talker" in message.appeared for message in recorded)
    assert all(message.nodes >= len(message.appeared) for message in recorded)


def test_without_the_wish_there_is_no_daemon(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(CONFIG.format(wanted="false"))
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until(
            lambda event: event["event"] == "node" and event["state"] == "loaded", "the talker"
        )
        assert look(daemon_address()).kind is Kind.NOBODY
        replay.process.send_signal(signal.SIGINT)
        assert "graph" not in {event["event"] for event in replay.read_all()}
