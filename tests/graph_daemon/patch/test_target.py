"""Finding the Python of ROS 2 and asking it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from play_launch.graph_daemon.patch import PatchError
from play_launch.graph_daemon.patch.install import overlays, plan_patch, remove
from play_launch.graph_daemon.patch.manifest import PACKAGE
from play_launch.graph_daemon.patch.target import find_target
from tests.graph_daemon.patch.conftest import LIMIT, Ros


def script(folder: Path, first: str) -> dict[str, str]:
    """Write a command ``ros2``; returns an environment that finds it."""
    folder.mkdir(exist_ok=True)
    path = folder / "ros2"
    path.write_text(f"{first}\nraise SystemExit('not to be run')\n", encoding="utf-8")
    path.chmod(0o755)
    return {"PATH": str(folder)}


def test_the_python_of_the_command_is_asked(ros: Ros, tmp_path: Path) -> None:
    target = find_target(None, script(tmp_path / "bin", f"#!{ros.python} -s"))
    assert target.python == ros.python
    assert target.folder == ros.ros2cli
    assert target.version == "0.32.2"
    assert target.sites == (ros.site,)
    assert target.user_site is None


def test_env_in_the_first_line_is_followed(ros: Ros, tmp_path: Path) -> None:
    environment = script(tmp_path / "bin", "#!/usr/bin/env python3")
    environment["PATH"] += f":{ros.python.parent}"
    assert find_target(None, environment).python == ros.python.parent / "python3"


def test_without_ros2_the_fix_is_shown(tmp_path: Path) -> None:
    with pytest.raises(PatchError, match=r"source your ROS 2 first.*--python"):
        find_target(None, {"PATH": str(tmp_path)})


@pytest.mark.parametrize("first", ["#!/bin/sh", "ELF", "#!", "#!/nowhere/python3"])
def test_a_command_that_is_no_python_script(tmp_path: Path, first: str) -> None:
    with pytest.raises(PatchError, match="name it: --python PATH"):
        find_target(None, script(tmp_path / "bin", first))


def test_a_python_without_ros2cli(tmp_path: Path) -> None:
    subprocess.run(
        [sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "empty")],
        check=True,
        timeout=LIMIT,
    )
    with pytest.raises(PatchError, match="has no ros2cli; source your ROS 2 first"):
        find_target(tmp_path / "empty" / "bin" / "python", {})


def test_ros2cli_without_its_release(ros: Ros) -> None:
    for path in ros.site.glob("ros2cli-*/METADATA"):
        path.unlink()
        path.parent.rmdir()
    with pytest.raises(PatchError, match="is not recorded"):
        ros.target()


@pytest.mark.parametrize("program", ["/nowhere/python", "/bin/false", "/bin/echo"])
def test_what_is_no_python(program: str) -> None:
    with pytest.raises(PatchError, match=r"cannot be run|does not work as a Python"):
        find_target(Path(program), {})


def test_our_own_libraries_are_kept_from_another_python(ros: Ros) -> None:
    environment = {
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
        "LD_LIBRARY_PATH": f"{sys.prefix}/lib:/opt/ros/lib:",
        "ROS_DISTRO": "jazzy",
    }
    target = find_target(ros.python, environment)
    assert target.environment == {"LD_LIBRARY_PATH": "/opt/ros/lib", "ROS_DISTRO": "jazzy"}


def test_a_sourced_ros_is_patched_for_its_user(ros: Ros, tmp_path: Path) -> None:
    """As after ``source /opt/ros/…/setup.bash``: found by PYTHONPATH, where .pth has no effect."""
    python = Path(os.path.realpath(sys.executable))
    home = tmp_path / "home"
    environment = {"PYTHONPATH": str(ros.site), "PYTHONUSERBASE": str(home)}
    target = find_target(python, environment)
    assert target.folder == ros.ros2cli
    assert target.place(for_user=False) == target.sites[0] != ros.site
    before = ros.tree()
    planned = plan_patch(target, for_user=True, known=ros.known)
    assert planned.place.is_relative_to(home)
    planned.carry_out()
    assert ros.tree() == before
    assert (planned.place / PACKAGE).is_dir()
    ((place, manifest),) = overlays(target)
    assert place == planned.place
    remove(place, manifest)
    assert not home.exists()
