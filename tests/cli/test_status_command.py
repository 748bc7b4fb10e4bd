"""``play-launch status`` and ``demo``, with real processes."""

from __future__ import annotations

import json
from pathlib import Path

from play_launch.cli.demo import DEMO
from tests.support.replay import replaying, run
from tests.support.waiting import until

CONFIG = """
version: 1
name: robot
record: {ros: false}
nodes:
  - {name: talker, command: [sh, -c, "echo ready; exec sleep 1000"]}
  - {name: failing, command: [sh, -c, "echo lost; exit 7"]}
"""


def test_status_tells_all_about_one_process(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(CONFIG, encoding="utf-8")
    session = ("--session", str(tmp_path / "logs" / "latest"))
    with replaying(config, tmp_path / "logs", "-q"):
        until(lambda: "ready" in run("status", "talker", *session).stdout, "its output")
        shown = run("status", "talker", *session)
        assert shown.returncode == 0, shown.stderr
        lines = [line.strip() for line in shown.stdout.splitlines()]
        assert lines[0] == "/talker - process"
        assert any(line.startswith("State: running since ") for line in lines)
        assert any(line.startswith("Process: pid ") for line in lines)
        assert f"Declared: {config}:6" in lines
        assert lines[-1].endswith(" ready")
        (row,) = json.loads(run("status", "talker", "--json", *session).stdout)
        assert (row["name"], row["wanted"]) == ("/talker", True)
        failed = run("status", "failing", *session)
        assert failed.returncode == 3
        assert "Process: exited with 7" in failed.stdout
        assert run("status", "nothing", *session).returncode == 2


def test_the_demo_is_part_of_the_package(tmp_path: Path) -> None:
    assert DEMO.is_file()
    done = run("demo", "--seconds", "8s", "-q", "--json", "--log-dir", tmp_path)
    summary = json.loads(done.stdout.splitlines()[-1])
    assert sum(each["loaded"] for each in summary["containers"]) == 8, done.stderr
    assert done.returncode == 0
