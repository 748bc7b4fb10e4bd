"""Commands that wait: for what, until when, and for how long."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import cast

import pytest

from play_launch.cli.wait import _Managed
from play_launch.control.protocol import PROTOCOL, OperationError, decode, encode
from play_launch.control.registration import LINKS, address_of
from play_launch.control.sessions import connect_to
from play_launch.ros.node_services import NodeServices
from tests.control.links import put_link
from tests.support.replay import COMMAND, replaying, run

DEAF = """
import signal, time
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
print("deaf now", flush=True)
while True:
    time.sleep(1000)
"""


def test_a_session_is_ended_in_order_from_another_shell(tmp_path: Path) -> None:
    deaf, config = tmp_path / "deaf.py", tmp_path / "robot.yaml"
    deaf.write_text(DEAF, encoding="utf-8")
    config.write_text(
        "version: 1\nstop: {sigint: 300 s, sigterm: 300 s}\nnodes:\n"
        f"- {{name: deaf, command: [{sys.executable}, {deaf}]}}\n",
        encoding="utf-8",
    )
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until(lambda event: event.get("text") == "deaf now", "a deaf process")
        late = replay.ask("shutdown", "--timeout", "0.1s", code=4)
        assert "is not over after 0.1 s" in late.stderr
        assert replay.ask("ps", code=0).stdout.count("stopping") == 1
        # Again: SIGTERM without 300 s for SIGINT, and SIGKILL.
        replay.ask("shutdown", code=0)
        assert replay.process.wait(0) == 128 + signal.SIGTERM
        assert replay.bag.read_bytes().endswith(b"\x89MCAP0\r\n")
        gone = replay.ask("shutdown", code=1)
        assert "no session is running in" in gone.stderr


def test_a_requested_container_brings_nodes_that_gave_up(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(
        "version: 1\ncontainers:\n- name: box\n  container_type: isolated\n"
        "  restart: {max_restarts: 3}\n  composable_nodes:\n"
        "  - {package: play_launch_demo, plugin: 'play_launch_demo::Talker', name: talker,\n"
        "     restart: {max_restarts: 0}}\n",
        encoding="utf-8",
    )
    with replaying(config, tmp_path / "logs") as replay:
        replay.until(event="node", node="/talker", state="loaded")
        replay.until_operable()
        replay.ask("signal", "SEGV", "/talker", code=0)
        replay.until(event="node", node="/talker", state="gave up")
        os.kill(replay.pids()["/box"], signal.SIGKILL)
        replay.until(event="container", container="/box", state="backoff")
        replay.until(event="container", container="/box", state="running")
        rows = json.loads(replay.ask("ps", "--json", "/talker").stdout)
        assert [each["state"] for each in rows] == ["gave up"]
        replay.ask("restart", "/box", code=0)
        replay.until(event="node", node="/talker", state="loaded")


def test_a_wait_ends_when_its_unit_can_no_longer_come_up(tmp_path: Path) -> None:
    deaf, config = tmp_path / "deaf.py", tmp_path / "robot.yaml"
    deaf.write_text(DEAF, encoding="utf-8")
    config.write_text(
        f"version: 1\nstop: {{sigint: 5 s}}\nnodes:\n"
        f"- {{name: deaf, command: [{sys.executable}, {deaf}]}}\n"
        f"- {{name: late, command: [sleep, '1000'], start_delay: 1000 s}}\n",
        encoding="utf-8",
    )
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until(lambda event: event.get("text") == "deaf now", "a deaf process")
        folder = str(replay.log_dir / "latest")
        with connect_to(folder) as waiting, ThreadPoolExecutor(1) as thread:
            answer = thread.submit(waiting.ask, "wait", {"timeout": 600.0}, limit=600.0)
            replay.process.send_signal(signal.SIGINT)
            with pytest.raises(OperationError, match="the session is being stopped"):
                answer.result(timeout=60)


def test_what_is_applied_meanwhile_is_what_is_waited_for(tmp_path: Path) -> None:
    config, target = tmp_path / "robot.yaml", tmp_path / "target.yaml"
    kept = "version: 1\nnodes:\n- {name: kept, command: [sleep, '1000']}\n"
    late = "- {name: late, command: [sleep, '1000'], start_delay: 1000 s}\n"
    config.write_text(kept + late, encoding="utf-8")
    target.write_text(kept + "- {name: new, command: [sleep, '1000']}\n", encoding="utf-8")
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until(lambda event: event.get("kind") == "started", "a process")
        session = ("--session", str(replay.log_dir / "latest"))
        waiting = subprocess.Popen(
            [COMMAND, "wait", "--json", *session], stdout=subprocess.PIPE, text=True
        )
        with waiting:
            run("apply", target, *session, code=0)
            said, _ = waiting.communicate(timeout=60)
        assert waiting.returncode == 0
        assert json.loads(said)["names"] == ["/kept", "/new"]


def test_the_time_until_a_session_begins_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(LINKS, str(tmp_path / "links"))
    command = [str(COMMAND), "wait", "--timeout", "60"]
    with socket.socket(socket.AF_UNIX) as listening, subprocess.Popen(command) as waiting:
        with address_of(str(tmp_path)) as address:
            listening.bind(address)
        listening.listen()
        put_link(tmp_path / "links", waiting.pid, tmp_path)
        listening.settimeout(60)
        session, _ = listening.accept()
        with session, session.makefile("rb") as lines:
            hello = {"protocol": PROTOCOL, "version": "1", "pid": 1, "name": "robot"}
            hello |= {"session": "x", "folder": str(tmp_path), "started_ns": 0}
            session.sendall(encode({"hello": hello}))
            request = decode(lines.readline())
            assert 0 < request["arguments"]["timeout"] < 60
            session.sendall(encode({"id": request["id"], "result": {"results": []}}))
            assert waiting.wait(60) == 0


class SlowGraph:
    """A graph of which services are seen at given seconds of a clock of its own."""

    def __init__(self, seen: dict[float, dict[str, list[str]]]) -> None:
        self.now = 0.0
        self._seen = seen

    def services(self) -> dict[str, list[str]]:
        return {k: v for at, each in self._seen.items() if at <= self.now for k, v in each.items()}

    def until(self, is_so: Callable[[], bool], deadline: float) -> bool:
        while not is_so():
            if self.now >= deadline:
                return False
            self.now += 0.1
        return True


@pytest.mark.parametrize(("at", "deadline", "found"), [(2, 10, ["/a"]), (20, 10, [])])
def test_a_managed_node_is_known_by_services_that_are_seen_late(
    at: float, deadline: float, found: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = SlowGraph({at: {"/a/get_state": ["lifecycle_msgs/srv/GetState"]}})
    monkeypatch.setattr(time, "monotonic", lambda: graph.now)
    assert (
        _Managed(cast("NodeServices", graph)).among(["/a", "/process"], {"/a"}, deadline) == found
    )
