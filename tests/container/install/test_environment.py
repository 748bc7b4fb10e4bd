"""What children find in their environment."""

from __future__ import annotations

from pathlib import Path

from play_launch.container.environment import (
    BOOTSTRAP_MARK,
    child_environment,
    foreign_python_environment,
)
from play_launch.container.ros import RosInstallation, RosSource

VENV = Path("/venv")
WHEELS = RosInstallation(RosSource.WHEELS, VENV, (VENV / "lib", VENV / "site" / "ros_a.libs"))
SYSTEM = RosInstallation(RosSource.SYSTEM, VENV, (VENV / "lib",))


def test_wheels_are_complete() -> None:
    made = child_environment({"PATH": "/bin", "HOME": "/home"}, WHEELS)
    assert made["LD_LIBRARY_PATH"] == "/venv/lib:/venv/site/ros_a.libs"
    assert made["AMENT_PREFIX_PATH"] == "/venv"
    assert made["PATH"] == "/venv/bin:/bin"
    assert made[BOOTSTRAP_MARK] == "1"
    assert made["HOME"] == "/home"


def test_a_sourced_ros_gets_our_prefix_added_only() -> None:
    base = {
        "PATH": "/opt/ros/jazzy/bin:/bin",
        "LD_LIBRARY_PATH": "/opt/ros/jazzy/lib",
        "AMENT_PREFIX_PATH": "/ws:/opt/ros/jazzy",
    }
    made = child_environment(base, SYSTEM)
    assert made["PATH"] == base["PATH"]
    assert made["LD_LIBRARY_PATH"] == "/venv/lib:/opt/ros/jazzy/lib"
    assert made["AMENT_PREFIX_PATH"] == "/venv:/ws:/opt/ros/jazzy"
    assert BOOTSTRAP_MARK not in made


def test_doing_it_again_changes_nothing() -> None:
    base = {"PATH": "/bin:/venv/bin", "LD_LIBRARY_PATH": "/x:/venv/lib::", "AMENT_PREFIX_PATH": ""}
    for ros in (WHEELS, SYSTEM):
        once = child_environment(base, ros)
        assert child_environment(once, ros) == once
        assert once["PATH"] == base["PATH"]
        assert once["LD_LIBRARY_PATH"].endswith("/x")


def test_what_was_set_wins_over_defaults_and_what_was_declared_over_all() -> None:
    made = child_environment({}, WHEELS)
    assert made["PYTHONUNBUFFERED"] == "1"
    assert made["RCUTILS_COLORIZED_OUTPUT"] == "0"
    made = child_environment({"RCUTILS_COLORIZED_OUTPUT": "1"}, WHEELS, {"LD_LIBRARY_PATH": "/x"})
    assert made["RCUTILS_COLORIZED_OUTPUT"] == "1"
    assert made["LD_LIBRARY_PATH"] == "/x"


def test_a_python_of_another_environment_finds_its_own_ros() -> None:
    made = child_environment({"LD_LIBRARY_PATH": "/mine", "PATH": "/bin"}, WHEELS)
    changed = foreign_python_environment(made, WHEELS, Path("/other/bin/python3.12"))
    assert BOOTSTRAP_MARK not in changed
    assert changed["LD_LIBRARY_PATH"] == "/mine"
    assert "AMENT_PREFIX_PATH" not in changed
    for program in ("/venv/bin/python3", "/bin/sleep", "/usr/bin/python3-config"):
        assert foreign_python_environment(made, WHEELS, Path(program)) == made
    made = child_environment({}, SYSTEM)
    assert foreign_python_environment(made, SYSTEM, Path("/usr/bin/python3")) == made
