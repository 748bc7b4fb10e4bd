"""What is measured is up, or nothing is measured."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from benchmarks.running import running

ROOT = Path(__file__).parents[2]
CONFIG = """
version: 1
containers:
  - name: chat
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}
      - {package: play_launch_demo, plugin: "play_launch_demo::SECOND", name: second}
"""


def write(folder: Path, second: str) -> Path:
    path = folder / "config.yaml"
    path.write_text(CONFIG.replace("SECOND", second), encoding="utf-8")
    return path


def test_a_system_is_up_in_the_block_and_summed_up_behind_it(tmp_path: Path) -> None:
    with running(write(tmp_path, "Talker"), tmp_path / "logs", 2) as run:
        process = psutil.Process(run.pid)
        assert process.is_running()
        assert (run.last["event"], run.last["kind"]) == ("component", "loaded")
    assert not process.is_running()
    assert run.last["event"] == "summary"
    assert run.last["containers"][0]["loaded"] == 2


@pytest.mark.parametrize("plugin", ["ThrowingConstructor", "NoSuchPlugin"])
def test_a_missing_node_is_an_error(tmp_path: Path, plugin: str) -> None:
    with (
        pytest.raises(SystemExit, match="only 1 of 2 nodes were loaded"),
        running(write(tmp_path, plugin), tmp_path / "logs", 2, limit=3),
    ):
        raise AssertionError("measured")
    assert not psutil.Process().children(recursive=True)


def test_recorded_topics_are_measured() -> None:
    name = "small at 1 kHz"
    command = [sys.executable, "-m", "benchmarks.recorder", "--seconds", "1", "--json"]
    result = subprocess.run(
        [*command, "--cases", name],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
        timeout=120,
    )
    figures = json.loads(result.stdout)[name]
    assert figures["messages/s"] > 0
    assert figures["MB/s"] > 0
    assert figures["topic_recorder % of a core"] > 0
