"""A virtual environment with a made-up ros2cli in it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from play_launch.graph_daemon.patch import write
from tests.support.replay import finished

STAND_IN = Path(__file__).with_name("stand_in")
LIMIT = 60.0


@dataclass(frozen=True)
class Ros:
    """The environment."""

    root: Path
    python: Path
    site: Path

    def run(self, code: str) -> str:
        outcome = finished([str(self.python), "-c", code], code=0, env={})
        return outcome.stdout.strip()


@pytest.fixture(scope="session")
def changing_ros(tmp_path_factory: pytest.TempPathFactory) -> Ros:
    return make_ros(tmp_path_factory.mktemp("changing") / "ros")


@pytest.fixture
def ros(changing_ros: Ros) -> Ros:
    """One whose packages are as if the test were the first."""
    shutil.rmtree(changing_ros.site)
    fill(changing_ros.site)
    return changing_ros


@pytest.fixture(scope="session")
def patched_ros(tmp_path_factory: pytest.TempPathFactory) -> Ros:
    """One that is patched, for tests that do not change it."""
    ros = make_ros(tmp_path_factory.mktemp("patched") / "ros")
    write(ros.site)
    return ros


def make_ros(root: Path) -> Ros:
    subprocess.run(
        [sys.executable, "-m", "venv", "--without-pip", str(root)], check=True, timeout=LIMIT
    )
    (site,) = root.glob("lib/python3*/site-packages")
    fill(site)
    return Ros(root, root / "bin" / "python", site)


def fill(site: Path) -> None:
    for package in ("ros2cli", "rclpy"):
        shutil.copytree(
            STAND_IN / package,
            site / package,
            ignore=shutil.ignore_patterns("__pycache__"),
        )
    write_release(site, "0.32.2")


def write_release(site: Path, version: str) -> None:
    for old in site.glob("ros2cli-*.dist-info"):
        shutil.rmtree(old)
    facts = site / f"ros2cli-{version}.dist-info"
    facts.mkdir()
    text = f"Metadata-Version: 2.1\nName: ros2cli\nVersion: {version}\n"
    (facts / "METADATA").write_text(text, encoding="utf-8")
