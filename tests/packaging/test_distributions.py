"""What is published: two distributions of one version."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from xml.etree import ElementTree as ET

import yaml

ROOT = Path(__file__).resolve().parents[2]
NATIVE = ROOT / "container_native"
INTERFACES = ROOT / "interfaces" / "play_launch_msgs"


def test_one_version_stands_everywhere() -> None:
    projects = [tomllib.loads((folder / "pyproject.toml").read_text()) for folder in (ROOT, NATIVE)]
    version = projects[0]["project"]["version"]
    assert projects[1]["project"]["version"] == version
    extra = projects[0]["project"]["optional-dependencies"]["jazzy"]
    assert extra == [f"play-launch-container[jazzy]=={version}"]
    for manifest in (
        *ROOT.glob("*/*/package.xml"),
        NATIVE / "package.xml",
        *NATIVE.glob("*/package.xml"),
    ):
        assert f"<version>{version}</version>" in manifest.read_text(), manifest
    assert f"version: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert f'set(PLAY_LAUNCH_VERSION "{version}")' in (NATIVE / "CMakeLists.txt").read_text()
    assert re.search(
        rf"^## {re.escape(version)}\b", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE
    )


def test_what_builds_the_ros_packages_knows_them_and_what_they_need() -> None:
    """As colcon and bloom look for packages: not below an ignored folder or another package."""
    files = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    paths = [Path(line) for line in files.stdout.splitlines()]
    ignored = {path.parent for path in paths if path.name == "COLCON_IGNORE"}
    manifests = [path for path in paths if path.name == "package.xml"]
    packages = {path.parent for path in manifests}
    found = {
        folder.name: ET.parse(ROOT / folder / "package.xml").getroot()
        for folder in packages
        if not (ignored | packages) & set(folder.parents) and folder not in ignored
    }
    assert {root.findtext("name") for root in found.values()} == {
        "play_launch_container",
        "play_launch_msgs",
    }
    needed = {each.text or "" for root in found.values() for each in root if "depend" in each.tag}
    names = {"libconsole-bridge-dev": "console_bridge"}
    pixi = tomllib.loads((ROOT / "pixi.toml").read_text())
    missing = {
        names.get(key, f"ros-jazzy-{key.replace('_', '-')}")
        for key in needed - {"play_launch_msgs"}
    } - pixi["dependencies"].keys()
    assert not missing
    tracks = yaml.safe_load((NATIVE / "packaging" / "tracks.yaml").read_text())["tracks"]
    assert {track["ros_distro"] for track in tracks.values()} == tracks.keys()


def test_commands_for_pip_are_for_that_of_debian_12() -> None:
    """Which is 23.0, and has `--config-settings` without the short form."""
    pages = (ROOT / "README.md", *(ROOT / "docs").rglob("*.md"))
    commands = [
        line
        for page in pages
        for line in page.read_text().splitlines()
        if "pip install" in line or "--config-settings" in line
    ]
    assert any("--config-settings" in command for command in commands)
    assert not [command for command in commands if re.search(r"\s-C\s", command)]


def test_the_supervisor_is_for_any_machine_and_has_all_it_reads(tmp_path: Path) -> None:
    build = "import sys; from hatchling.build import build_wheel; build_wheel(sys.argv[1])"
    subprocess.run([sys.executable, "-c", build, tmp_path], cwd=ROOT, check=True)
    (wheel,) = tmp_path.iterdir()
    assert wheel.name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
        listed = subprocess.run(
            ["git", "ls-files", "play_launch"], cwd=ROOT, check=True, capture_output=True, text=True
        ).stdout.split()
        messages = "play_launch/container/cdr/msg"
        listed.remove(messages)  # a link to the interface package, whose files the wheel has
        listed += [f"{messages}/{path.name}" for path in (INTERFACES / "msg").iterdir()]
        assert set(listed) <= held
        assert not [name for name in held if name.endswith(".so")]
