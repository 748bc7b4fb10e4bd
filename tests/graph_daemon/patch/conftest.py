"""A ROS 2 of a kind: an environment with a made-up ros2cli in it."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from play_launch.graph_daemon.patch.install import plan_patch
from play_launch.graph_daemon.patch.known import KNOWN, Known, definition_digest
from play_launch.graph_daemon.patch.target import Target, find_target

STAND_IN = Path(__file__).with_name("stand_in")
LIMIT = 60.0


@dataclass(frozen=True)
class Ros:
    """The environment; ``known`` makes its ros2cli one that can be patched."""

    root: Path
    python: Path
    site: Path
    known: Known

    @property
    def ros2cli(self) -> Path:
        return self.site / "ros2cli"

    def target(self) -> Target:
        return find_target(self.python, {"PATH": "/nowhere"})

    def tree(self) -> dict[str, bytes]:
        """Every file but what Python has compiled."""
        return {
            str(path.relative_to(self.site)): path.read_bytes()
            for path in sorted(self.site.rglob("*"))
            if path.is_file() and "__pycache__" not in path.parts
        }

    def run(self, code: str) -> str:
        outcome = subprocess.run(
            [str(self.python), "-c", code],
            capture_output=True,
            text=True,
            timeout=LIMIT,
            check=True,
            env={},
        )
        return outcome.stdout.strip()


def known_of(folder: Path) -> Known:
    """Take what is in ``folder`` for known, under the release numbers of the real table."""
    definitions = {}
    for file, names in KNOWN.definitions.items():
        source = (folder / file).read_text(encoding="utf-8")
        present = {node.name for node in ast.parse(source).body if hasattr(node, "name")}
        definitions[file] = {
            name: frozenset({definition_digest(source, name)}) for name in names if name in present
        }
    return Known(KNOWN.series, definitions)


@pytest.fixture
def ros(tmp_path: Path) -> Ros:
    """One of the test's own."""
    return make_ros(tmp_path / "ros")


@pytest.fixture(scope="session")
def patched_ros(tmp_path_factory: pytest.TempPathFactory) -> Ros:
    """One that is patched, for tests that only use it."""
    ros = make_ros(tmp_path_factory.mktemp("patched") / "ros")
    plan_patch(ros.target(), known=ros.known).carry_out()
    return ros


def make_ros(root: Path) -> Ros:
    subprocess.run(
        [sys.executable, "-m", "venv", "--without-pip", str(root)], check=True, timeout=LIMIT
    )
    (site,) = root.glob("lib/python3*/site-packages")
    for package in ("ros2cli", "rclpy"):
        shutil.copytree(
            STAND_IN / package,
            site / package,
            ignore=shutil.ignore_patterns("__pycache__"),
        )
    write_release(site, "0.32.2")
    return Ros(root, root / "bin" / "python", site, known_of(site / "ros2cli"))


def write_release(site: Path, version: str) -> None:
    for old in site.glob("ros2cli-*.dist-info"):
        shutil.rmtree(old)
    facts = site / f"ros2cli-{version}.dist-info"
    facts.mkdir()
    text = f"Metadata-Version: 2.1\nName: ros2cli\nVersion: {version}\n"
    (facts / "METADATA").write_text(text, encoding="utf-8")
