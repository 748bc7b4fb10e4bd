"""`dump` and `launch`, as installed, on launch files of the project's own components."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.launch_files import recorded
from tests.support.launch import SLEEPER, needs_launch, use_launch
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


ROBOT = """
from pathlib import Path
from launch import LaunchDescription
from launch.actions import *
from launch.launch_description_sources import AnyLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

def generate_launch_description():
    more = AnyLaunchDescriptionSource(str(Path(__file__).with_name("more.launch.py")))
    return LaunchDescription([
        DeclareLaunchArgument("rate", default_value="20.0", description="messages per second"),
        ExecuteProcess(cmd=["echo", "rate", LaunchConfiguration("rate")], name="rate"),
        IncludeLaunchDescription(more),
    ])
"""


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a launch file, and the one that it includes."""
    use_launch(monkeypatch)
    (tmp_path / "files").mkdir()
    (tmp_path / "files/more.launch.py").write_text(SLEEPER, encoding="utf-8")
    path = tmp_path / "files/robot.launch.py"
    path.write_text(ROBOT, encoding="utf-8")
    return path


@needs_launch
def test_launch_brings_up_nodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded.add_programs(tmp_path / "installed", monkeypatch)
    words = (recorded.ROBOT, tmp_path / "log", "--container-type", "isolated")
    with replaying(*words, program=launch(tmp_path)) as replay:
        replay.read_until_states(recorded.NODES)


def launch(folder: Path) -> tuple[str]:
    """Return a program that does `launch` where `replay` is expected."""
    program = folder / "launch"
    program.write_text(
        f"""#!{sys.executable}
import os, sys
os.execv({str(COMMAND)!r}, [{str(COMMAND)!r}, "launch", *sys.argv[2:]])
""",
        encoding="utf-8",
    )
    program.chmod(0o755)
    return (str(program),)


def test_launch_brings_up_what_the_launch_file_says(robot: Path, tmp_path: Path) -> None:
    # Another word for replay, and another way to name the system; all else is the same.
    with replaying(robot, tmp_path / "log", program=launch(tmp_path)) as replay:
        replay.read_until(lambda event: event.get("name") == "/a", "its process")
        recorded = next((tmp_path / "log").glob("*/session.mcap*"))
    assert recorded.name
    assert replay.process.returncode == 130


def test_a_dry_run_starts_nothing(robot: Path) -> None:
    shown = run("launch", robot, "rate:=25.0", "--dry-run").stdout
    assert "echo rate 25.0" in shown
    assert "sleep 1000" in shown


@needs_launch
def test_a_prefix_for_programs_and_the_output_of_all(robot: Path) -> None:
    """As with `ros2 launch`, by its options and by the argument that they stand for."""
    text = robot.read_text(encoding="utf-8").replace('name="rate"', 'name="rate", output="log"')
    robot.write_text(text, encoding="utf-8")
    plain = run("dump", robot).stdout
    assert "output: log" in plain
    assert "prefix: " not in plain
    by_options = run(
        "dump", robot, "-a", "--launch-prefix", "nice -n 3", "--launch-prefix-filter=ec"
    )
    assert "output: log" not in by_options.stdout
    assert by_options.stdout.count('prefix: "nice -n 3"\n') == 1
    assert "no launch file declares" not in by_options.stderr
    words = ("launch-prefix:=nice -n 3", "launch-prefix-filter:=ec")
    by_arguments = run("dump", robot, "-a", *words).stdout
    assert by_arguments.splitlines()[1:] == by_options.stdout.splitlines()[1:]
    assert "nice -n 3" in run("launch", robot, "-n", "--launch-prefix", "nice -n 3").stdout


def test_an_evaluation_is_no_service(robot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a launch file runs does not speak to the manager of services in the name of it."""
    monkeypatch.setenv("NOTIFY_SOCKET", str(robot.parent / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", "60000000")
    seen = 'str({"NOTIFY_SOCKET", "WATCHDOG_USEC"} & {*__import__("os").environ})'
    robot.write_text(SLEEPER.replace('"1000"', seen), encoding="utf-8")
    assert "'set()'" in run("launch", robot, "--dry-run").stdout


def test_arguments_are_shown(robot: Path) -> None:
    shown = run("dump", robot, "--show-args").stdout
    assert "rate  (default: 20.0)\n    messages per second\n" in shown
    found = json.loads(run("dump", robot, "--show-args", "--json").stdout)["arguments"]
    assert [each["name"] for each in found] == ["rate"]
    assert found[0]["place"].endswith("robot.launch.py:11")


@pytest.mark.parametrize("command", [("dump",), ("launch", "-n")])
def test_an_argument_that_is_not_declared_is_noted(robot: Path, command: tuple[str, ...]) -> None:
    verb, *more = command
    stderr = run(verb, robot, "rat:=3.0", *more).stderr
    assert "note: no launch file declares the argument rat\n" in stderr


def test_json_is_for_programs(robot: Path) -> None:
    found: dict[str, Any] = json.loads(run("dump", robot, "--json").stdout)
    assert found["processes"] == 2
    assert [Path(each).name for each in found["files"]] == ["robot.launch.py", "more.launch.py"]
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
    text = run("dump", "my_robot", "robot.launch.py").stdout
    assert "# from my_robot/launch/robot.launch.py:12\n" in text
    assert "nothing.xml; it has " in run("dump", "my_robot", "nothing.xml", code=2).stderr
    missing = run("dump", "no_robot", "robot.launch.py", code=2).stderr
    assert "package no_robot is not installed" in missing


def test_errors_leave_nothing_behind(robot: Path, tmp_path: Path) -> None:
    path = robot.with_name("more.launch.py")
    path.write_text("\nraise ValueError('no such robot')\n", encoding="utf-8")
    before = sorted(tmp_path.rglob("*"))
    done = run("dump", robot, "-o", tmp_path / "robot.yaml", code=2)
    assert done.stderr.startswith(f"error: {path}:2: ValueError: no such robot\n")
    assert f"\n  included from {robot}:13\n" in done.stderr
    run("launch", robot, "--log-dir", tmp_path / "log", code=2)
    after = sorted(each for each in tmp_path.rglob("*") if "__pycache__" not in str(each))
    assert after == before


def test_what_gets_lost_is_an_error_if_strict(robot: Path, tmp_path: Path) -> None:
    path = robot.with_name("more.launch.py")
    text = SLEEPER.replace("([", "([Shutdown(), ").replace("Process\n", "Process, Shutdown\n")
    path.write_text(text, encoding="utf-8")
    target = tmp_path / "robot.yaml"
    done = run("dump", robot, "-o", target)
    assert f"not carried over: {path}:4" in done.stderr
    target.unlink()
    run("dump", robot, "-o", target, "--strict", code=2)
    assert not target.exists()
    done = run("launch", robot, "--strict", "--log-dir", tmp_path / "log", code=2)
    assert "nothing was started" in done.stderr
    assert not (tmp_path / "log").exists()


@pytest.mark.parametrize(
    "words", [["a", "b", "c"], ["x:=1", "a.launch.py"], ["a.launch.py", "x:=1", "x:=2"]]
)
def test_wrong_usage(words: list[str], tmp_path: Path) -> None:
    assert run("dump", *words, code=2).stderr.startswith("error: ")


def test_a_file_that_cannot_be_written(robot: Path, tmp_path: Path) -> None:
    output = tmp_path / "missing" / "robot.yaml"
    done = run("dump", robot, "-o", output, code=1)
    assert done.stderr == (
        f"error: {output}: No such file or directory; name another file with --output\n"
    )
