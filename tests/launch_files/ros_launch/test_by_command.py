"""`play-launch dump` on launch files in Python: by ROS's launch, or by the stand-in for it."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from tests.launch_files.ros_launch.prefix import Prefix, prefix
from tests.launch_files.ros_launch.test_errors import python
from tests.support.launch import IS_INSTALLED
from tests.support.replay import COMMAND
from tests.support.waiting import until

__all__ = ["prefix"]

PRINTS = """
print("loading")
def generate_launch_description():
    return LaunchDescription([ExecuteProcess(cmd=["sleep", "10"])])
"""
RAISES = """
def generate_launch_description():
    raise ValueError("no such robot")
"""


def dump(path: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [COMMAND, "dump", path, *words], check=False, capture_output=True, text=True, timeout=120
    )


def test_what_is_printed_is_no_part_of_the_configuration(prefix: Prefix) -> None:
    done = dump(prefix.file("a.launch.py", python(PRINTS)))
    assert done.returncode == 0, done.stderr
    assert "loading" not in done.stdout
    assert "loading" in done.stderr
    assert "command: [sleep" in done.stdout


@pytest.mark.parametrize("verb", ["dump", "launch"])
def test_a_launch_file_that_starts_nothing(prefix: Prefix, verb: str) -> None:
    path = prefix.file(
        "a.launch.py",
        python("def generate_launch_description():\n    return LaunchDescription([])\n"),
    )
    done = subprocess.run(
        [COMMAND, verb, path], check=False, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 2
    assert "nothing to start: conditions and arguments leave no program\n" in done.stderr
    assert "mistake" not in done.stderr


@pytest.mark.parametrize("verb", ["dump", "launch"])
@pytest.mark.parametrize("name", ["a.launch.py", "a.launch.xml", "a.launch.yaml"])
def test_the_missing_package_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: str, name: str
) -> None:
    """Something else that is called `launch` is there, as from PyPI."""
    if IS_INSTALLED:
        pytest.skip("launch_ros is installed here")
    (tmp_path / "other" / "launch").mkdir(parents=True)
    (tmp_path / "other" / "launch" / "__init__.py").touch()
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "other"))
    (tmp_path / name).write_text("launch:\n", encoding="utf-8")
    done = subprocess.run(
        [COMMAND, verb, tmp_path / name], check=False, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 2
    assert done.stderr == (
        f"error: {tmp_path / name}: launch_ros, which evaluates launch files, is not installed "
        "here; source a ROS with launch_ros, or run `play-launch dump` where it is\n"
    )


BESIDE = """
from ament_index_python.packages import get_package_share_directory
def generate_launch_description():
    share = get_package_share_directory("play_launch_demo")
    return LaunchDescription([ExecuteProcess(cmd=["ls", share])])
"""


def test_packages_beside_play_launch_are_found_where_no_workspace_is_sourced(
    prefix: Prefix, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    done = dump(prefix.file("a.launch.py", python(BESIDE)))
    assert done.returncode == 0, done.stderr
    assert f"{sys.prefix}/share/play_launch_demo" in done.stdout
    assert "AMENT_PREFIX_PATH" not in done.stdout


@pytest.mark.parametrize("words", [(), ("--json",), ("--show-args",)])
def test_an_error_has_its_place(prefix: Prefix, words: tuple[str, ...]) -> None:
    path = prefix.file("a.launch.py", python(RAISES))
    done = dump(path, *words)
    assert done.returncode == 2
    assert f"{path}:6: ValueError: no such robot" in done.stdout + done.stderr
    assert "Traceback" not in done.stderr


def test_nothing_is_left_of_an_evaluation_that_is_interrupted(
    prefix: Prefix, tmp_path: Path
) -> None:
    pid_file = tmp_path / "pid"
    path = prefix.file(
        "a.launch.py",
        "import os, time\n"
        f"open({str(pid_file)!r}, 'w').write(f'{{os.getpid()}}.')\n"
        "time.sleep(1000)\n",
    )
    command = subprocess.Popen([COMMAND, "dump", path], stderr=subprocess.PIPE, text=True)
    until(lambda: pid_file.exists() and pid_file.read_text().endswith("."), "the evaluation")
    evaluating = psutil.Process(int(pid_file.read_text().rstrip(".")))
    command.send_signal(signal.SIGINT)
    _, errors = command.communicate(timeout=60)
    assert command.returncode != 0
    assert "Traceback" not in errors
    until(lambda: not evaluating.is_running(), "its end")
