"""The installed command with the installed container: the parts together, once."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import psutil

from play_launch.container.ros import RosSource, ros_installation
from tests.recording.reading import messages
from tests.support.replay import run

if TYPE_CHECKING:
    from pathlib import Path

CONFIG = """
version: 1
name: real
containers:
  - name: chat
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}
      - {package: play_launch_demo, plugin: "play_launch_demo::Listener", name: listener}
"""


def test_a_mistake_leads_to_the_help_of_its_command() -> None:
    for words in (["inspect", "--around"], ["inspect", "--frobnicate"], ["compare", "a"]):
        done = run(*words)
        assert done.returncode == 2
        assert done.stderr.endswith(f"see 'play-launch {words[0]} --help'\n"), done.stderr


def test_nodes_load_talk_stop_and_are_recorded(tmp_path: Path) -> None:
    config = tmp_path / "real.yaml"
    config.write_text(CONFIG, encoding="utf-8")
    command = [sys.executable, "-c", "from play_launch.cli.app import main; main()"]
    process = subprocess.Popen(
        [*command, "replay", str(config), "--log-dir", str(tmp_path / "logs"), "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    pids: set[int] = set()
    for line in process.stdout:
        event = json.loads(line)
        if event["event"] == "process" and event["kind"] == "started":
            pids.add(event["pid"])
        if event["event"] == "output" and "I heard" in event["text"]:
            break
    process.send_signal(signal.SIGINT)
    out, err = process.communicate()

    assert err == ""
    assert process.returncode == 130
    summary = json.loads(out.splitlines()[-1])
    assert summary["containers"][0]["loaded"] == 2
    assert len(pids) == 1
    assert not any(psutil.pid_exists(pid) for pid in pids)
    found = messages(tmp_path / "logs" / "latest" / "session.mcap")
    events = [read.message for read in found if read.topic == "/play_launch/events"]
    for name in ("/talker", "/listener"):
        kinds = [event.event_type for event in events if event.full_node_name == name]
        assert kinds == [4, 0, 1], "loading, loaded, unloaded"
    states = [read.message for read in found if read.topic == "/play_launch/states"]
    ended = [state for state in states if state.kind == state.PROCESS][-1]
    assert (ended.state, ended.exit_code, ended.signal) == ("exited", 0, 0)
    assert any("I heard" in read.message.msg for read in found if "output" in read.topic)


def test_a_middleware_that_is_not_there_is_told_before_anything_starts(tmp_path: Path) -> None:
    config = tmp_path / "real.yaml"
    config.write_text(CONFIG, encoding="utf-8")
    ros = ros_installation()
    result = run(
        "replay",
        config,
        "--log-dir",
        str(tmp_path / "logs"),
        env={**os.environ, "RMW_IMPLEMENTATION": "rmw_nowhere_cpp"},
    )
    assert result.returncode != 0
    assert "rmw_nowhere_cpp" in result.stdout + result.stderr
    if ros.source is RosSource.WHEELS:
        assert result.returncode == 2
        assert "is linked to rmw_fastrtps_cpp: unset RMW_IMPLEMENTATION" in result.stderr
        assert not (tmp_path / "logs").exists()


def test_the_daemon_refuses_a_middleware_that_is_not_there(ros_domain: int) -> None:
    result = run(
        "daemon",
        "start",
        env={
            **os.environ,
            "RMW_IMPLEMENTATION": "rmw_nowhere_cpp",
            "ROS_DOMAIN_ID": str(ros_domain),
        },
    )
    assert result.returncode == 2
    assert "rmw_nowhere_cpp" in result.stderr
