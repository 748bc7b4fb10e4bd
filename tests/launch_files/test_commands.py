"""`dump` and `launch`, as installed, on launch files of the project's own components."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from play_launch.config.load import load_config
from tests.launch_files import system
from tests.support.replay import COMMAND, replaying


def run(*words: str | Path, code: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [str(COMMAND), *map(str, words)],
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == code, done.stderr
    return done


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    system.add_containers(tmp_path / "installed", monkeypatch)
    (tmp_path / "files").mkdir()
    return system.write(tmp_path / "files")


def test_dump_writes_what_replay_brings_up(robot: Path, tmp_path: Path) -> None:
    target = tmp_path / "robot.yaml"
    done = run("dump", robot, "rate:=25.0", "-o", target, "--strict")
    assert "1 container with 2 nodes, 2 processes; 0 not carried over" in done.stderr
    first = target.read_text(encoding="utf-8")
    run("dump", robot, "rate:=25.0", "-o", target)
    assert target.read_text(encoding="utf-8") == first
    config = load_config(target)
    talker, listener = config.containers[0].composable_nodes
    assert {each.name: each.value.value for each in talker.parameters} == {
        "rate": 25.0,
        "prefix": "from the file",
    }
    assert dict(listener.remappings) == {"chatter": "/words"}
    # The same for all three is said once.
    assert first.count("ROBOT") == 1
    assert config.containers[0].environment["ROBOT"] == "small"
    with replaying(target, tmp_path / "log") as replay:
        replay.read_until_states(system.NODES)


def test_a_file_in_which_nothing_was_changed_is_named(robot: Path, tmp_path: Path) -> None:
    text = robot.read_text(encoding="utf-8").replace('<param name="rate"', '<param name="other"')
    robot.write_text(text, encoding="utf-8")
    target = robot.parent / "robot.yaml"
    run("dump", robot, "-o", target)
    assert "params.yaml" in target.read_text(encoding="utf-8")
    (talker, _) = load_config(target).containers[0].composable_nodes
    assert {each.name for each in talker.parameters} == {"rate", "prefix", "other"}
    run("dump", robot, "-o", target, "--inline")
    assert "params.yaml" not in target.read_text(encoding="utf-8")


def test_launch_brings_up_what_the_launch_file_says(robot: Path, tmp_path: Path) -> None:
    # Another word for replay, and another way to name the system; all else is the same.
    program = tmp_path / "launch"
    program.write_text(
        f"""#!{sys.executable}
import os, sys
os.execv({str(COMMAND)!r}, [{str(COMMAND)!r}, "launch", *sys.argv[2:]])
""",
        encoding="utf-8",
    )
    program.chmod(0o755)
    with replaying(
        robot,
        tmp_path / "log",
        "--container-type",
        "isolated",
        program=(str(program),),
    ) as replay:
        replay.read_until_states(system.NODES)
        recorded = next((tmp_path / "log").glob("*/session.mcap*"))
    assert recorded.name
    assert replay.process.returncode == 130


def test_a_dry_run_starts_nothing(robot: Path) -> None:
    shown = run("launch", robot, "--dry-run", "--container-type", "isolated").stdout
    assert "/robot/box" in shown
    assert "--isolated" in shown
    assert "sleep 100" in shown


def test_a_prefix_for_programs_and_the_output_of_all(robot: Path) -> None:
    """As with `ros2 launch`, by its options and by the argument that they stand for."""
    text = robot.read_text(encoding="utf-8").replace('name="tiny"', 'name="tiny" output="log"')
    robot.write_text(text, encoding="utf-8")
    plain = run("dump", robot).stdout
    assert "output: log" in plain
    assert "prefix: " not in plain
    by_options = run(
        "dump", robot, "-a", "--launch-prefix", "nice -n 3", "--launch-prefix-filter=ti"
    )
    assert "output: log" not in by_options.stdout
    assert by_options.stdout.count('prefix: "nice -n 3"\n') == 1
    assert "no launch file declares" not in by_options.stderr
    words = ("launch-prefix:=nice -n 3", "launch-prefix-filter:=ti")
    by_arguments = run("dump", robot, "-a", *words).stdout
    assert by_arguments.splitlines()[1:] == by_options.stdout.splitlines()[1:]
    assert "nice -n 3" in run("launch", robot, "-n", "--launch-prefix", "nice -n 3").stdout


def test_an_evaluation_is_no_service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a launch file runs does not speak to the manager of services in the name of it."""
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", "60000000")
    text = """<launch>
<let name="seen" value="$(env NOTIFY_SOCKET nothing) $(env WATCHDOG_USEC nothing)"/>
<executable cmd="echo seen: $(var seen)"/></launch>"""
    path = tmp_path / "a.launch.xml"
    path.write_text(text, encoding="utf-8")
    shown = run("launch", path, "--dry-run").stdout
    assert "seen: 'nothing nothing'" in shown


def test_arguments_are_shown(robot: Path) -> None:
    shown = run("dump", robot, "--show-args").stdout
    assert "rate  (default: 20.0)\n    messages per second\n" in shown
    found = json.loads(run("dump", robot, "--show-args", "--json").stdout)["arguments"]
    assert [each["name"] for each in found] == ["rate", "with_tiny"]
    assert found[0]["place"].endswith("robot.launch.xml:2")


@pytest.mark.parametrize("command", [("dump",), ("launch", "-n")])
def test_an_argument_that_nobody_declares_is_noted(robot: Path, command: tuple[str, ...]) -> None:
    verb, *more = command
    stderr = run(verb, robot, "rat:=3.0", *more).stderr
    assert "note: no launch file declares the argument rat\n" in stderr


def test_json_is_for_programs(robot: Path) -> None:
    found: dict[str, Any] = json.loads(run("dump", robot, "--json").stdout)
    assert found["containers"] == 1
    assert [Path(each).name for each in found["files"]] == ["robot.launch.xml", "more.launch.yaml"]
    assert found["config"].startswith("# From ")
    assert found["lost"] == found["problems"] == []


def test_a_package_and_a_file(robot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    prefix = tmp_path / "prefix"
    index = prefix / "share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    (index / "my_robot").touch()
    (prefix / "share/my_robot").mkdir()
    robot.parent.rename(prefix / "share/my_robot/launch")
    both = os.pathsep.join(filter(None, [str(prefix), os.environ.get("AMENT_PREFIX_PATH", "")]))
    monkeypatch.setenv("AMENT_PREFIX_PATH", both)
    text = run("dump", "my_robot", "robot.launch.xml").stdout
    assert "# from my_robot/launch/robot.launch.xml:8\n" in text
    assert "nothing.xml; it has " in run("dump", "my_robot", "nothing.xml", code=2).stderr
    assert "no package no_robot" in run("dump", "no_robot", "robot.launch.xml", code=2).stderr


@pytest.mark.parametrize(
    ("text", "message"),
    [
        # In the words of ROS's launch where that is installed.
        ("<launch>\n<node exec='$(var x)'/></launch>", r"2: .*(argument or variable x|'x' does)"),
        ("<launch>", "1: is not XML: no element found"),
        ("<launch>\n<arg name='x'/></launch>", "2: .*argument .?x.? .*; give "),
    ],
)
def test_errors_leave_nothing_behind(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.launch.xml"
    path.write_text(text, encoding="utf-8")
    done = run("dump", path, "-o", tmp_path / "robot.yaml", code=2)
    assert re.match(f"error: {path}:{message}", done.stderr)
    run("launch", path, "--log-dir", tmp_path / "log", code=2)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["bad.launch.xml"]


def test_what_gets_lost_is_an_error_if_strict(tmp_path: Path) -> None:
    path = tmp_path / "shutdown.launch.xml"
    path.write_text('<launch><executable cmd="true"/>\n<shutdown/></launch>', encoding="utf-8")
    target = tmp_path / "robot.yaml"
    done = run("dump", path, "-o", target)
    assert f"not carried over: {path}:2" in done.stderr
    target.unlink()
    run("dump", path, "-o", target, "--strict", code=2)
    assert not target.exists()
    done = run("launch", path, "--strict", "--log-dir", tmp_path / "log", code=2)
    assert "nothing was started" in done.stderr
    assert not (tmp_path / "log").exists()


@pytest.mark.parametrize(
    "words", [["a", "b", "c"], ["x:=1", "a.launch.xml"], ["a.launch.xml", "x:=1", "x:=2"]]
)
def test_wrong_usage(words: list[str], tmp_path: Path) -> None:
    assert run("dump", *words, code=2).stderr.startswith("error: ")


def test_a_file_that_cannot_be_written(robot: Path, tmp_path: Path) -> None:
    output = tmp_path / "missing" / "robot.yaml"
    done = run("dump", robot, "-o", output, code=1)
    assert done.stderr == (
        f"error: {output}: No such file or directory; name another file with --output\n"
    )
