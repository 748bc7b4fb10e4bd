"""The patch is copied, acts on the releases that it was written for, and is removed."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from play_launch.graph_daemon.patch import PatchError, default_folder
from tests.graph_daemon.patch.conftest import Ros, write_release
from tests.support.replay import run

COMMAND = Path(sys.executable).parent / "play-launch"
MARKS = """
import ros2cli.daemon, ros2cli.node.network_aware, ros2cli.xmlrpc.local_server, sys
names = ("daemon", "node.network_aware", "xmlrpc.local_server")
print(*(getattr(sys.modules["ros2cli." + name], "__play_launch__", "stock") for name in names))
"""


def command(ros: Ros, *words: str) -> tuple[int, str]:
    done = run(
        "daemon", *words, env={**os.environ, "PATH": str(ros.root / "bin"), "PYTHONPATH": ""}
    )
    return done.returncode, done.stdout + done.stderr


def files(ros: Ros) -> dict[Path, bytes]:
    found = (path for path in ros.site.rglob("*") if "__pycache__" not in path.parts)
    return {path: path.read_bytes() for path in found if path.is_file()}


@pytest.fixture
def with_ros2(ros: Ros) -> Ros:
    program = ros.root / "bin" / "ros2"
    program.write_text(f"#!{ros.python}\n")
    program.chmod(0o755)
    return ros


def test_written_and_removed(with_ros2: Ros) -> None:
    ros, before = with_ros2, files(with_ros2)
    assert command(ros, "patch", "--dry-run")[0] == 0
    assert files(ros) == before
    for _ in range(2):
        code, text = command(ros, "patch")
        assert (code, f"written to {ros.site}" in text) == (0, True)
    assert {path: files(ros)[path] for path in before} == before
    assert ros.run(MARKS) == "daemon_modules daemon_modules serving"
    code, text = command(ros, "unpatch")
    assert (code, f"removed the patch from {ros.site}" in text) == (0, True)
    assert files(ros) == before
    assert ros.run(MARKS) == "stock stock stock"
    code, text = command(ros, "unpatch")
    assert (code, "nothing to do" in text) == (0, True)


@pytest.mark.parametrize(
    ("version", "is_changed"),
    [("0.18.11", True), ("0.32.2", True), ("0.33.0", False), ("0.3.2", False)],
)
def test_other_releases_stay_as_they_are(ros: Ros, version: str, *, is_changed: bool) -> None:
    assert command(ros, "patch", "--into", str(ros.site))[0] == 0
    write_release(ros.site, version)
    assert (ros.run(MARKS) != "stock stock stock") == is_changed


def test_a_module_that_is_different_stays_as_it_is(ros: Ros) -> None:
    assert command(ros, "patch", "--into", str(ros.site))[0] == 0
    (ros.site / "ros2cli" / "node" / "network_aware.py").write_text("class Other: ...\n")
    code = "import ros2cli.node.network_aware as module; print(module.__play_launch__)"
    assert ros.run(code).startswith("daemon_modules failed: AttributeError")


def test_a_sourced_ros_is_patched_in_the_users_packages(tmp_path: Path) -> None:
    site = tmp_path / "jazzy" / "lib" / "python3.12" / "site-packages"
    (site / "ros2cli").mkdir(parents=True)
    folder = default_folder({"PATH": "/nowhere", "PYTHONPATH": str(site)})
    assert folder == Path.home() / ".local/lib/python3.12/site-packages"


def test_without_ros2cli_the_fix_is_named(ros: Ros, tmp_path: Path) -> None:
    with pytest.raises(PatchError, match="source your ROS 2 first, or use --into FOLDER"):
        default_folder({"PATH": "/nowhere"})
    (tmp_path / "file").touch()
    code, text = command(ros, "patch", "--into", str(tmp_path / "file" / "below"))
    assert code == 2
    assert "run the command as a user with write permission" in text
