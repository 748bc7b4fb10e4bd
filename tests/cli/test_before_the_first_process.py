"""What is imported before the first process is started: all of the start waits for it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.support.replay import finished, replaying

CONFIG = """
version: 1
name: start
containers:
  - name: chat
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: talker}
"""
# Ends as the first process would be started, and prints what is imported then.
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
    "email",
    "importlib.metadata",
    "lark",
    "mcap.writer",
    "numpy",
    "play_launch.runtime.stock_containers",
    "play_launch.cli.daemon",
    "play_launch.cli.doctor",
    "play_launch.cli.node",
    "play_launch.control.client",
    "play_launch.control.operations",
    "play_launch.control.server",
    "play_launch.doctor",
    "play_launch.graph_daemon",
    "play_launch.ros.thread",
    "play_launch.process.sampling",
    "play_launch_msgs",
    "pydantic",
    "rcl_interfaces",
    "rclpy",
    "rich",
    "rosidl_generator_py",
    "textual",
}
"""Packages and modules, with what is below them, that have no place before the first process."""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "start.yaml"
    path.write_text(CONFIG, encoding="utf-8")
    return path


def belongs_to(module: str, package: str) -> bool:
    return module == package or module.startswith(f"{package}.")


def imported_before_the_first_process(config: Path, tmp_path: Path) -> set[str]:
    result = finished(
        [sys.executable, "-c", PROGRAM, "replay", str(config), "--log-dir", str(tmp_path), "-q"],
        code=0,
    )
    return set(json.loads(result.stderr))


def test_only_what_the_start_needs_is_imported_before_it(config: Path, tmp_path: Path) -> None:
    imported = imported_before_the_first_process(config, tmp_path)
    assert "play_launch.process.guard" in imported
    early = {module for module in imported for late in LATER if belongs_to(module, late)}
    assert early == set()


def test_containers_of_ours_need_no_rclpy(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # It is looked for before anything is started: the compiled part is there, and does not load.
    fake = tmp_path / "python" / "rclpy"
    fake.mkdir(parents=True)
    (fake / "_rclpy_pybind11.so").touch()
    (fake / "__init__.py").write_text("raise ImportError('libx.so: cannot open')", "utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "python"))
    with replaying(config, tmp_path / "logs") as run:
        run.read_until_states({"/talker": "loaded"})
