"""Packages, launch files and their arguments at a cursor."""

from __future__ import annotations

from pathlib import Path

import pytest

from play_launch.cli.completion.launch_files import launch_words

LAUNCH_FILE = """<launch>
  <arg name="rate" default="20.0" description="messages
    per second"/>
  <arg name="robot"><choice value="a b"/><choice value="c"/></arg>
  <arg name="sim" default="false"/>
  <let name="never" value="$(command 'touch started')"/>
</launch>
"""


@pytest.fixture(autouse=True)
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    index = tmp_path / "share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    (index / "my_robot").touch()
    (tmp_path / "share/my_robot/launch").mkdir(parents=True)
    for name in ("robot.launch.xml", "rviz.launch.py", "model.urdf"):
        (tmp_path / "share/my_robot/launch" / name).write_text(LAUNCH_FILE, encoding="utf-8")
    (tmp_path / "my_own.launch.xml").write_text(LAUNCH_FILE, encoding="utf-8")
    (tmp_path / "bad.launch.xml").write_text("<launch", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))


def words(*line: str) -> list[str] | None:
    found = launch_words(line[:-1], line[-1])
    return None if found is None else [each.word for each in found.candidates]


ROBOT = ("my_robot", "robot.launch.xml")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (("my_",), ["my_robot", "my_own.launch.xml"]),
        (("./my",), None),
        (("nothing_begins_so",), None),
        (("my_robot", "r"), ["robot.launch.xml", "rviz.launch.py"]),
        (("no_robot", ""), []),
        ((*ROBOT, ""), ["rate:=", "robot:=", "sim:="]),
        (("my_own.launch.xml", "r"), ["rate:=", "robot:="]),
        ((*ROBOT, "rate:=1", "r"), ["robot:="]),
        ((*ROBOT, "robot:="), ["robot:=a b", "robot:=c"]),
        ((*ROBOT, "sim:=t"), ["sim:=true"]),
        ((*ROBOT, "rate:="), ["rate:=20.0"]),
        (("bad.launch.xml", ""), []),
    ],
)
def test_what_is_offered(line: tuple[str, ...], expected: list[str] | None, tmp_path: Path) -> None:
    assert words(*line) == expected
    assert not (tmp_path / "started").exists()


def test_arguments_say_what_they_are() -> None:
    found = launch_words(ROBOT, "")
    assert found is not None
    assert found.goes_on
    assert [each.about for each in found.candidates] == [
        "messages per second (default: 20.0)",
        "required",
        "default: false",
    ]
