"""Real rclcpp components, wherever rclcpp_components is installed.

It is on no package index, so where the wheels are the only ROS these tests cannot run.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from play_launch.config.substitutions import ament_prefixes
from play_launch.container.environment import child_environment
from play_launch.container.ros import component_container, ros_installation
from tests.container.conftest import spawn
from tests.support.ros import Probe

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

__all__ = ["spawn"]

SOURCES = Path(__file__).parent / "components"


def prefix_of(package: str) -> Path | None:
    """Where a ROS package is installed."""
    for prefix in ament_prefixes(os.environ):
        if (prefix / "share" / package / "package.xml").is_file():
            return prefix
    return None


def missing(packages: Sequence[str]) -> str | None:
    """Why a test that needs these packages cannot run."""
    absent = [package for package in packages if prefix_of(package) is None]
    if not absent:
        return None
    debian = " ".join(f"ros-jazzy-{package.replace('_', '-')}" for package in absent)
    return (
        f"not in AMENT_PREFIX_PATH: {', '.join(absent)} (on Ubuntu: apt install {debian}, and "
        "source /opt/ros/jazzy/setup.bash)"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Declare our marker."""
    config.addinivalue_line("markers", "needs_packages(*names): ROS packages that the test loads")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what cannot run."""
    for item in items:
        if Path(__file__).parent not in item.path.parents:
            continue
        marks = item.iter_markers("needs_packages")
        packages = ["rclcpp_components", *(package for mark in marks for package in mark.args)]
        reason = missing(packages)
        if reason is not None:
            item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(scope="session", autouse=True)
def backend_is_in() -> None:
    """The container under test loads rclcpp components."""
    line = subprocess.run(
        [component_container(), "--version"],
        env=child_environment(os.environ, ros_installation()),
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    assert "rclcpp" in line.split("components:")[1].split(), (
        "rclcpp_components is installed, but the container was built without it: build and "
        "install it again in this environment"
    )


@pytest.fixture(scope="session")
def built_components(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build our test components as a user would; the prefix in which they are installed."""
    folder = tmp_path_factory.mktemp("components")
    prefix = folder / "install"
    cmake = shutil.which("cmake")
    assert cmake is not None, "cmake is not in PATH"
    # The wheels' libraries name more libraries than they need, and not all of those exist.
    lenient = "-Wl,--as-needed -Wl,--allow-shlib-undefined"
    configure = [
        *(cmake, "-S", os.fspath(SOURCES), "-B", os.fspath(folder / "build")),
        f"-DCMAKE_INSTALL_PREFIX={prefix}",
        f"-DCMAKE_PREFIX_PATH={';'.join(map(str, ament_prefixes(os.environ)))}",
        f"-DCMAKE_SHARED_LINKER_FLAGS={lenient}",
        f"-DCMAKE_EXE_LINKER_FLAGS={lenient}",
    ]
    build = [cmake, "--build", os.fspath(folder / "build"), "--target", "install", "-j", "2"]
    for command in (configure, build):
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    return prefix


@pytest.fixture
def components(built_components: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Package with our test components, for containers that are started from now on."""
    prefixes = [built_components, *ament_prefixes(os.environ)]
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(map(str, prefixes)))
    return "test_components"


@pytest.fixture
def probe() -> Iterator[Probe]:
    """A node of ours that listens and asks."""
    with Probe() as node:
        yield node
