"""What `init` writes has no mistakes, and comes up."""

from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

from tests.support.replay import COMMAND, replaying

if TYPE_CHECKING:
    from pathlib import Path


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [str(COMMAND), *arguments]
    return subprocess.run(command, cwd=folder, check=False, capture_output=True, text=True)


def test_it_checks_clean_replays_and_is_never_overwritten(tmp_path: Path) -> None:
    assert run(tmp_path, "init").returncode == 0
    checked = run(tmp_path, "check", "robot.yaml")
    assert checked.returncode == 0, checked.stderr
    with replaying(tmp_path / "robot.yaml", tmp_path / "log", "rate:=50.0") as replay:
        replay.read_until_states({"/talker": "loaded", "/listener": "loaded"})
    (tmp_path / "robot.yaml").write_text("mine")
    (tmp_path / "of FILE").mkdir()
    assert run(tmp_path, "init", "of FILE/SCHEMA.yaml").returncode == 0
    first, *others = (tmp_path / "of FILE" / "SCHEMA.yaml").read_text().splitlines()
    assert first.endswith("/config.schema.json")
    assert "#     play-launch replay SCHEMA.yaml" in "\n".join(others)
    again = run(tmp_path, "init", "robot.yaml")
    assert again.returncode == 2
    assert "is there already" in again.stderr
    assert (tmp_path / "robot.yaml").read_text() == "mine"
