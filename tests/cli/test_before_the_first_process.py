"""What is imported before the first process is started: everybody waits for it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.replay import COMMAND

CONFIG = """
version: 1
name: start
containers:
  - name: chat
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}
"""
# Ends as the first process would be started, and says what is imported then.
PROGRAM = """
import json, os, sys
def hook(event, arguments):
    if event in {"subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn", "os.exec"}:
        os.write(2, json.dumps(sorted(sys.modules)).encode())
        os._exit(0)
sys.addaudithook(hook)
from play_launch.cli.entry import main
main()
"""
LATER = {
    "composition_interfaces",
    "em",
    "lark",
    "numpy",
    "play_launch.actors.stock",
    "play_launch.cli.daemon",
    "play_launch.cli.doctor",
    "play_launch.cli.graph",
    "play_launch.cli.show.summary",
    "play_launch.doctor",
    "play_launch.graph_daemon",
    "play_launch.ros",
    "play_launch_msgs",
    "rcl_interfaces",
    "rclpy",
    "rich",
    "rosidl_generator_py",
    "typer",
}
"""Packages and modules, with what is below them, that have no place before the first process."""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "start.yaml"
    path.write_text(CONFIG, encoding="utf-8")
    return path


def belongs_to(module: str, package: str) -> bool:
    return module == package or module.startswith(f"{package}.")


def test_only_what_the_start_needs_is_imported_before_it(config: Path, tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM, "replay", str(config), "--log-dir", str(tmp_path), "-q"],
        check=True,
        capture_output=True,
        text=True,
    )
    imported = set(json.loads(result.stderr))
    assert "play_launch.process.guard" in imported
    early = {module for module in imported for late in LATER if belongs_to(module, late)}
    assert early == set()


def test_a_ros_that_does_not_load_ends_the_system(config: Path, tmp_path: Path) -> None:
    # Not visible before: the compiled part is there, and fails only when it is imported.
    fake = tmp_path / "python" / "rclpy"
    fake.mkdir(parents=True)
    (fake / "_rclpy_pybind11.so").touch()
    (fake / "__init__.py").write_text("raise ImportError('libx.so: cannot open')", "utf-8")
    result = subprocess.run(
        [COMMAND, "replay", str(config), "--log-dir", str(tmp_path / "logs")],
        env={**os.environ, "PYTHONPATH": str(tmp_path / "python")},
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 1
    assert "ROS does not work in this Python: libx.so: cannot open" in result.stdout
    assert "Traceback" not in result.stdout + result.stderr
