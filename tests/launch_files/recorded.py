"""What ROS's launch 3.4.3 has made of launch files, and what that becomes: a folder for each.

Those without a launch file in the folder are of ros2/demos and Nav2 (branch `jazzy`).
`python -m tests.launch_files.recorded NAME...` writes the others again, where launch is installed.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Final

import msgspec
import pytest

from play_launch.launch_files.configuration.request import Options
from play_launch.launch_files.configuration.write import written
from play_launch.launch_files.records import Description
from play_launch.launch_files.ros_launch.evaluate import evaluate

FOLDER: Final = Path(__file__).parent / "records"
NAMES: Final = tuple(sorted(path.parent.name for path in FOLDER.glob("*/record.json")))
OWN: Final = tuple(name for name in NAMES if (FOLDER / name / "robot.launch.xml").exists())
ROBOT: Final = FOLDER / "robot/robot.launch.xml"
NODES: Final = {"/robot/talker": "loaded", "/listener": "loaded"}
"""The composable nodes of that one."""
_HERE: Final = "/recorded"
"""What stands for the folder of a launch file in its record."""


def record(name: str) -> str:
    """Return what stands in the record of a folder, evaluated now."""
    folder = FOLDER / name
    with tempfile.TemporaryDirectory() as installed, pytest.MonkeyPatch.context() as patch:
        add_programs(Path(installed), patch)
        found = msgspec.to_builtins(evaluate(folder / "robot.launch.xml", {}, limit=120.0))
    # The standard library's, for a parameter may be infinite.
    return json.dumps(found, indent=1, ensure_ascii=False).replace(str(folder), _HERE)


def description(name: str, folder: Path | None = None) -> Description:
    """Return a recorded description, of launch files in a folder."""
    content = (FOLDER / name / "record.json").read_text(encoding="utf-8")
    values = json.loads(content.replace(_HERE, str(folder or FOLDER / name)))
    return msgspec.convert(values, Description)


def configuration(name: str) -> str:
    """Return the configuration, with what it does not say behind it."""
    made = written(description(name), Options(folder=FOLDER / name), "From robot.launch.xml.")
    assert made.problems == ()
    text = made.text
    for each in made.losses:
        text += f"# {'note' if each.is_note else 'lost'}: {each.where}: {each.what}\n"
    return text.replace(str(FOLDER / name), _HERE)


def add_programs(prefix: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Add made-up packages for ROS's launch, which looks for their programs."""
    index = prefix / "share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    for program in (
        "play_launch_demo/tiny_node",
        "rclcpp_components/component_container",
        "two_nodes/server",
    ):
        path = prefix / "lib" / program
        path.parent.mkdir(parents=True)
        path.write_text("#!/bin/sh\n", encoding="utf-8")
        path.chmod(0o755)
        (index / path.parent.name).touch()
        (prefix / "share" / path.parent.name).mkdir()
    paths = [*filter(None, [os.environ.get("AMENT_PREFIX_PATH")]), str(prefix)]
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(paths))


if __name__ == "__main__":
    for each in sys.argv[1:]:
        (FOLDER / each / "record.json").write_text(record(each), encoding="utf-8")
        (FOLDER / each / "robot.yaml").write_text(configuration(each), encoding="utf-8")
