"""What `init` writes has no mistakes, and comes up."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.replay import replaying, run

if TYPE_CHECKING:
    from pathlib import Path


def test_it_checks_clean_replays_and_is_never_overwritten(tmp_path: Path) -> None:
    assert run("init", cwd=tmp_path).returncode == 0
    checked = run("check", "robot.yaml", cwd=tmp_path)
    assert checked.returncode == 0, checked.stderr
    with replaying(tmp_path / "robot.yaml", tmp_path / "log", "rate:=50.0") as replay:
        replay.read_until_states({"/talker": "loaded", "/listener": "loaded"})
    (tmp_path / "robot.yaml").write_text("mine")
    (tmp_path / "of FILE").mkdir()
    assert run("init", "of FILE/SCHEMA.yaml", cwd=tmp_path).returncode == 0
    first, *others = (tmp_path / "of FILE" / "SCHEMA.yaml").read_text().splitlines()
    assert first.endswith("/config.schema.json")
    assert "#     play-launch replay SCHEMA.yaml" in "\n".join(others)
    again = run("init", "robot.yaml", cwd=tmp_path)
    assert again.returncode == 2
    assert "is there already" in again.stderr
    assert (tmp_path / "robot.yaml").read_text() == "mine"
