"""The page about launch files shows what `dump` writes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from play_launch.config.load import load_config
from tests.launch_files import system
from tests.launch_files.test_commands import run

PAGE = Path(__file__).resolve().parents[2] / "docs" / "launch-files.md"
BLOCK = re.compile(r"<!-- (file|written): (\S+) -->\n```\w+\n(.*?)```", re.DOTALL)


def test_the_examples_are_what_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    system.add_containers(tmp_path / "installed", monkeypatch)
    monkeypatch.chdir(tmp_path)
    found = {kind: (name, text) for kind, name, text in BLOCK.findall(PAGE.read_text("utf-8"))}
    name, text = found["file"]
    Path(name).write_text(text, encoding="utf-8")
    shown, expected = found["written"]
    assert shown == name
    assert run("dump", name).stdout == expected
    run("dump", name, "rate:=10.0", "-o", "robot.yaml", "--strict")
    (talker,) = load_config(Path("robot.yaml")).containers[0].composable_nodes
    assert [each.value.value for each in talker.parameters] == [10.0]
