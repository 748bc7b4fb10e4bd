"""ROS's launch for tests, or a stand-in for it: launch files in Python with processes only."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

import pytest

from play_launch.launch_files.ros_launch.evaluate import missing_package

IS_INSTALLED: Final = not missing_package()
needs_launch: Final = pytest.mark.skipif(
    not IS_INSTALLED, reason="ROS's launch and launch_ros are not installed here"
)
_STAND_IN: Final = Path(__file__).parents[1] / "launch_files" / "stand_in"
SLEEPER: Final = """from launch import LaunchDescription
from launch.actions import ExecuteProcess
def generate_launch_description():
    return LaunchDescription([ExecuteProcess(cmd=["sleep", "1000"], name="a")])
"""
"""A launch file of one process."""


def use_launch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have this process and commands find the stand-in where launch is not installed."""
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    if not IS_INSTALLED:
        folders = [str(_STAND_IN), *filter(None, [os.environ.get("PYTHONPATH")])]
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join(folders))
        monkeypatch.syspath_prepend(str(_STAND_IN))
