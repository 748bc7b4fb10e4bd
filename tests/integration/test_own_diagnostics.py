"""`play-launch diagnostics`: what other tools hear of a system, as a process of it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from play_launch.cli.diagnostics import _of_unit
from tests.cli.top.rows import row
from tests.support.replay import COMMAND, Replay, recorded, replaying, run
from tests.support.scenes import node, written

MONITOR = """
import os
import sys
import time
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
rclpy.init()
node = rclpy.create_node("monitor")
publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
while True:
    level, text = (b"\\0", "fine") if os.path.exists(sys.argv[1]) else (b"\\2", "no data")
    status = DiagnosticStatus(level=level, name="lidar: data", message=text)
    own = DiagnosticStatus(level=b"\\2", name="play_launch: /c")
    publisher.publish(DiagnosticArray(status=[status, own]))
    time.sleep(0.2)
"""


def statuses(replay: Replay) -> list[dict[str, Any]]:
    """Give the arrays in a recording, by the names of the statuses."""
    arrays = recorded(replay.bag, "/diagnostics")
    return [{each.name: each for each in array.status} for array in arrays]


@pytest.mark.parametrize(
    ("state", "level"),
    [("running", 0), ("stopped", 0), ("starting", 1), ("gave up", 2), ("unreachable", 3)],
)
def test_levels_follow_from_states(state: str, level: int) -> None:
    found = _of_unit(row("/a", state, machine="h3"))
    assert (found.level, found.hardware_id) == (bytes([level]), "h3")


def test_units_and_topics_have_their_statuses(tmp_path: Path) -> None:
    config = written(
        tmp_path,
        name="monitored",
        environment={"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        expect={"/chatter": {"min_rate": 1}},
        containers=[
            {
                "name": "c",
                "container_type": "isolated",
                "composable_nodes": [node("talker", on_crash="ignore")],
            }
        ],
        nodes=[
            {
                "name": "status",
                "command": [
                    *(str(COMMAND), "diagnostics", "--period", "200ms"),
                    *("--session", str(tmp_path / "logs" / "latest")),
                ],
            }
        ],
    )
    with replaying(config, tmp_path / "logs") as replay:
        replay.until(event="expectation", topic="/chatter", is_met=True)
        os.kill(replay.pids()["/talker"], signal.SIGSEGV)
        replay.until(event="expectation", topic="/chatter", is_met=False)
        replay.ask("load", "talker", code=0)
        replay.until(event="expectation", topic="/chatter", is_met=True)
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()
        assert [
            (each["exit_code"], each["signal"])
            for each in replay.told(event="process", name="/status", kind="exited")
        ] == [(0, 0)]
    found = statuses(replay)
    talker, topic = "play_launch: /c:/talker", "play_launch: topic /chatter"
    assert {"play_launch: /c", "play_launch: /status", talker, topic} == found[-1].keys()
    told = {(array[talker].level, array[talker].message) for array in found}
    assert (0, "loaded") in told
    assert any(level == 2 and "SIGSEGV" in message for level, message in told)
    assert {each.key for each in found[-1][talker].values} >= {"restarts", "crashes"}
    broken = [array[topic] for array in found if topic in array and array[topic].level == 2]
    assert "no publisher" in {each.message for each in broken}
    assert broken[0].hardware_id
    # The states of units say the same.
    explained = run("explain", replay.bag, code=1).stdout
    assert "/talker in /c crashed" in explained
    assert "play_launch:" not in explained


def test_a_wait_demands_the_diagnostics_of_others(tmp_path: Path) -> None:
    script, repaired = tmp_path / "monitor.py", tmp_path / "repaired"
    script.write_text(MONITOR)
    command = [sys.executable, str(script), str(repaired)]
    config = written(
        tmp_path, containers=[{"name": "c"}], nodes=[{"name": "monitor", "command": command}]
    )
    with replaying(config, tmp_path / "logs") as replay:
        ready = ("wait", "--for", "ready", "--diagnostics")
        refused = replay.ask(*ready, "--timeout", "8s", code=4)
        assert "not ready: lidar: data (no data)" in refused.stderr
        replay.ask("wait", "--for", "ready", code=0)
        replay.ask("wait", "--diagnostics", code=2)
        repaired.touch()
        replay.ask(*ready, code=0)


def test_what_nodes_report_can_be_followed(tmp_path: Path) -> None:
    script, repaired = tmp_path / "monitor.py", tmp_path / "repaired"
    script.write_text(MONITOR)
    command = [sys.executable, str(script), str(repaired)]
    config = written(tmp_path, nodes=[{"name": "monitor", "command": command}])
    with replaying(config, tmp_path / "logs") as replay:
        words = [str(COMMAND), "diagnostics", "--listen", "--session", str(replay.pid)]
        pipes: Any = {"stdout": subprocess.PIPE, "text": True}
        with (
            subprocess.Popen(words, **pipes) as text,
            subprocess.Popen([*words, "--json"], **pipes) as values,
        ):
            assert text.stdout is not None
            assert values.stdout is not None
            assert text.stdout.readline().endswith(" [lidar: data] ERROR: no data\n")
            assert json.loads(values.stdout.readline())["level"] == "ERROR"
            repaired.touch()
            assert text.stdout.readline().endswith(" [lidar: data] OK: fine\n")
            assert json.loads(values.stdout.readline())["message"] == "fine"
            text.send_signal(signal.SIGINT)
            assert text.wait(20) == 0
            replay.process.send_signal(signal.SIGINT)
            assert values.wait(20) == 0
        replay.read_all()
    run("diagnostics", "--json", code=2)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_may_be_ended_while_there_is_no_session(tmp_path: Path, number: signal.Signals) -> None:
    with subprocess.Popen(
        [COMMAND, "diagnostics"],
        env=os.environ | {"XDG_RUNTIME_DIR": str(tmp_path)},
        stderr=subprocess.PIPE,
        text=True,
    ) as waiting:
        assert waiting.stderr is not None
        assert waiting.stderr.readline() == "waiting for a session\n"
        waiting.send_signal(number)
        try:
            # By itself it would wait for a minute.
            assert waiting.wait(timeout=20) == -number
        finally:
            waiting.kill()
