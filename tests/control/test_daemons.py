"""What the installed command stops has no daemons left, also without a control group."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from play_launch.control.registration import LINKS
from tests.support.replay import Replay, alive, named, replaying, run
from tests.support.waiting import until

SYSTEM = """
version: 1
nodes:
  - {name: sleeper, command: [sleep, "1000"]}
  - {name: forks, command: [sh, -c, "(setsid sleep 1000 &); exec sleep 1000"]}
"""


def asked(*arguments: str) -> str:
    return run(*arguments, code=0).stdout


def sleeping(replay: Replay) -> list[int]:
    """Return the pids of the session's sleep processes, whatever their parent is."""
    return [each.pid for each in named(alive(replay.descendants()), "sleep")]


def test_a_daemon_is_stopped_with_the_process_that_started_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(LINKS, str(tmp_path / "links"))
    config = tmp_path / "robot.yaml"
    config.write_text(SYSTEM, encoding="utf-8")
    with replaying(config, tmp_path / "logs", "-q") as replay:
        asked("wait", "--timeout", "60")
        (sleeper,) = json.loads(asked("ps", "--json", "sleeper"))
        until(lambda: len(sleeping(replay)) == 3, "the daemon")
        assert asked("stop", "forks") == "/forks: stopped\n"
        assert sleeping(replay) == [sleeper["pid"]]
