"""``check --explain`` against what the processes of a real replay got."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import psutil
import pytest
import yaml

from tests.support.replay import Replay, replaying, run
from tests.support.waiting import until

SECRET = "hunter2-of-the-robot"
MARK = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
STAYS = "import signal, sys\nprint('up', flush=True)\nsignal.pause()\n"
KEPT = "sh -c '\"$@\"; exit' 'two words'"
"""A prefix that does not become what it starts: its command line stays in /proc."""


@pytest.fixture
def caller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """The environment of a shell in which nothing was prepared but a path of libraries."""
    monkeypatch.delenv(MARK, raising=False)
    monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path))
    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    monkeypatch.setenv("RCUTILS_COLORIZED_OUTPUT", "1")
    monkeypatch.setenv("TOKEN_OF_ROBOT", SECRET)
    return dict(os.environ)


@pytest.fixture
def held(tmp_path: Path) -> dict[str, Any]:
    """A program of a package that stays."""
    programs = tmp_path / "prefix" / "lib" / "holding"
    programs.mkdir(parents=True)
    (programs / "holder").symlink_to(sys.executable)
    script = tmp_path / "stays.py"
    script.write_text(STAYS, encoding="utf-8")
    return {
        "package": "holding",
        "executable": "holder",
        "arguments": ["-I", str(script)],
        "environment": {"AMENT_PREFIX_PATH": str(tmp_path / "prefix")},
    }


@pytest.fixture
def config(held: dict[str, Any], tmp_path: Path) -> Path:
    """Containers of ours, processes of a package and of another Python."""
    (tmp_path / "here").mkdir()
    talker = {"package": "play_launch_demo", "plugin": "play_launch_demo::Talker"}
    system = {
        "version": 1,
        "name": "explained",
        "environment": {"OF_ALL": "$'\"\\ \n"},
        "stop": {"ask": "500 ms"},
        "containers": [
            {
                "name": "apart",
                "container_type": "isolated_mt",
                "thread_num": 3,
                "composable_nodes": [{**talker, "name": "talker"}],
            },
            {"name": "together", "prefix": KEPT, "log_level": "warn", "namespace": "/deep/down"},
        ],
        "nodes": [
            {
                "name": "installed",
                **held,
                "parameters": {"rate": 2.0, "text": "${env:TOKEN_OF_ROBOT}"},
                "remappings": ["a:=/b"],
                "log_level": "debug",
                "ros_arguments": ["--disable-rosout-logs"],
                "cwd": "here",
                "emulate_tty": True,
            },
            {
                "name": "other_python",
                "command": [f"{sys.base_prefix}/bin/python3", *held["arguments"], "it's"],
                "environment": {"ACCESS_TOKEN": "plain", "SAID": "by ${env:TOKEN_OF_ROBOT}"},
                "prefix": KEPT,
            },
        ],
    }
    path = tmp_path / "explained.yaml"
    path.write_text(json.dumps(system), encoding="utf-8")
    return path


def explain(config: Path, *options: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    result = run("check", config, "--explain", *options)
    assert result.returncode == code, result.stdout + result.stderr
    return result


def explained(config: Path) -> dict[str | None, dict[str, Any]]:
    found = json.loads(explain(config, "--json").stdout)["processes"]
    return {each["name"]: each for each in found}


def running(replay: Replay) -> dict[str | None, psutil.Process]:
    """The processes by name; that of the recording has none."""
    asked = replay.ask("ps", "--json")
    if asked.returncode != 0:
        return {}
    rows = json.loads(asked.stdout)
    found: dict[str | None, psutil.Process] = {
        row["name"]: psutil.Process(row["pid"])
        for row in rows
        if row["pid"] is not None and row["kind"] != "component"
    }
    for process in replay.descendants():
        if process.cmdline()[:1] and process.cmdline()[0].endswith("/topic_recorder"):
            found[None] = process
    return found


def environment_of(process: psutil.Process) -> dict[str, str]:
    text = Path(f"/proc/{process.pid}/environ").read_bytes().decode()
    return dict(line.split("=", 1) for line in text.split("\0") if line)


def arguments_of(process: psutil.Process) -> list[str]:
    text = Path(f"/proc/{process.pid}/cmdline").read_bytes().decode()
    return text.removesuffix("\0").split("\0")


def is_alike(shown: str, real: str) -> bool:
    """Whether they are the same but for what is decided at the start, or kept secret."""
    if shown in {"(descriptor)", "(clock)"}:
        return real.removeprefix("-").isdecimal()
    if shown.startswith("(pid):"):
        pid, _, name = real.partition(":")
        return pid.isdecimal() and shown == f"(pid):{name}"
    if shown == "(redacted)":
        return real in {SECRET, "plain"}
    if shown == "(parameter file)":
        return Path(real).is_file()
    return shown == real.replace(SECRET, "(redacted)")


def compare(said: dict[str, Any], process: psutil.Process, caller: dict[str, str]) -> None:
    """Compare what is said of a process with what /proc says."""
    assert said["problem"] is None
    real = arguments_of(process)
    assert len(real) == len(said["argv"])
    for shown, word in zip(said["argv"], real, strict=True):
        assert is_alike(shown, word)
    expected = {key: value for key, value in caller.items() if key not in said["unset"]}
    expected |= said["environment"]
    found = environment_of(process)
    assert found.keys() == expected.keys()
    for key, value in found.items():
        assert value == caller.get(key) or is_alike(expected[key], value), key
    assert Path(f"/proc/{process.pid}/cwd").readlink() == Path(said["cwd"])
    is_terminal = "/pts/" in str(Path(f"/proc/{process.pid}/fd/1").readlink())
    assert is_terminal == said["emulate_tty"]
    if said["parameter_file"] is not None:
        file = Path(real[real.index("--params-file") + 1]).read_text(encoding="utf-8")
        assert is_alike(said["parameter_file"], file)


def test_what_is_explained_is_what_the_processes_get(
    config: Path, caller: dict[str, str], tmp_path: Path
) -> None:
    told = explained(config)
    assert list(told) == ["/apart", "/deep/down/together", "/installed", "/other_python", None]
    with replaying(config, tmp_path / "logs") as replay:
        until(lambda: running(replay).keys() == told.keys(), "all processes", 60)
        caller["PYTEST_CURRENT_TEST"] = os.environ["PYTEST_CURRENT_TEST"]
        for name, process in running(replay).items():
            compare(told[name], process, caller)
    # All of it was put to use.
    assert told["/other_python"]["unset"] == ["AMENT_PREFIX_PATH"]
    assert told["/other_python"]["environment"]["ACCESS_TOKEN"] == "(redacted)"
    assert told["/other_python"]["environment"]["SAID"] == "by (redacted)"
    assert "LD_LIBRARY_PATH" not in told["/other_python"]["environment"]
    assert "RCUTILS_COLORIZED_OUTPUT" not in told["/apart"]["environment"]
    assert told["/apart"]["environment"].keys() & {"LD_PRELOAD", "GLIBC_TUNABLES"}
    assert "(redacted)" in told["/installed"]["parameter_file"]


def test_so_does_a_stock_container(
    held: dict[str, Any], caller: dict[str, str], tmp_path: Path
) -> None:
    path = tmp_path / "stock.yaml"
    container = {"name": "box", "container_type": "stock", "prefix": "nice -n 1", **held}
    attached = {"name": "theirs", "container_type": "stock", "attach": True}
    system = {"version": 1, "containers": [container, attached], "record": {"ros": False}}
    path.write_text(json.dumps(system), encoding="utf-8")
    told = explained(path)
    assert list(told) == ["/box"]
    with replaying(path, tmp_path / "logs") as replay:
        until(lambda: running(replay).keys() == told.keys(), "the process", 60)
        # It becomes what it starts.
        assert told["/box"]["argv"][:3] == ["nice", "-n", "1"]
        del told["/box"]["argv"][:3]
        until(lambda: arguments_of(running(replay)["/box"])[0] != "nice", "the program", 60)
        caller["PYTEST_CURRENT_TEST"] = os.environ["PYTEST_CURRENT_TEST"]
        compare(told["/box"], running(replay)["/box"], caller)


def test_no_secret_is_printed(config: Path, caller: dict[str, str]) -> None:
    for options in ((), ("--json",)):
        assert SECRET not in explain(config, *options).stdout


def test_the_text_is_yaml_and_commands_for_a_shell(config: Path, caller: dict[str, str]) -> None:
    text, *commands = explain(config).stdout.split("\n# ")
    assert yaml.safe_load(text)["containers"][0]["full_name"] == "/apart"
    told = explained(config)
    for process in told.values():
        head = f"{process['name']} ({process['kind']}" if process["name"] else "for the recording"
        (block,) = [each for each in commands if each.startswith(head)]
    # Bash makes of it what the values are: each word, and each variable.
    block = next(each for each in commands if each.startswith("/deep/down/together"))
    _, _, command = block.partition("&& \\\nenv")
    words = subprocess.run(
        ["bash", "-c", f"printf '%s\\0' {command}"], check=True, capture_output=True, text=True
    ).stdout.split("\0")[:-1]
    process = told["/deep/down/together"]
    variables = [f"{name}={value}" for name, value in process["environment"].items()]
    assert words == [*variables, *process["argv"]]
    assert "OF_ALL=$'\"\\ \n" in words


def test_what_replay_starts_for_itself_is_named(
    config: Path, caller: dict[str, str], tmp_path: Path
) -> None:
    path = tmp_path / "plain.yaml"
    system = {"version": 1, "record": {"ros": False}, "nodes": [{"name": "n", "command": ["cat"]}]}
    path.write_text(json.dumps(system), encoding="utf-8")

    def named(file: Path) -> list[str]:
        found: list[str] = json.loads(explain(file, "--json").stdout)["helpers"]
        text = explain(file).stdout
        assert all(f"#   {each}\n" in text for each in found)
        return [each.partition(":")[0] for each in found]

    later = ["play_launch.postmortem.archive", "play_launch.ros.fastdds"]
    assert named(path) == ["spawn_guard", *later]
    assert named(config) == ["spawn_guard", "spawn_guard", *later]
    path.write_text(json.dumps({**system, "graph_daemon": True}), encoding="utf-8")
    assert named(path) == ["spawn_guard", "play_launch.graph_daemon", *later]


def test_what_cannot_be_started_is_named_and_the_rest_explained(tmp_path: Path) -> None:
    nodes = [
        {"name": "absent", "package": "nobody_has_this", "executable": "it"},
        {"name": "nowhere", "command": ["sleep", "1"], "cwd": str(tmp_path / "missing")},
        {"name": "unknown", "command": ["no_such_program"]},
        {"name": "long", "command": [f"/{'x' * 300}"]},
        {"name": "fine", "command": ["sleep", "1"]},
    ]
    path = tmp_path / "missing.yaml"
    path.write_text(json.dumps({"version": 1, "nodes": nodes}), encoding="utf-8")
    result = explain(path, "--json", code=1)
    told = {each["name"]: each for each in json.loads(result.stdout)["processes"]}
    assert "package nobody_has_this is not installed" in told["/absent"]["problem"]
    assert str(tmp_path / "missing") in told["/nowhere"]["problem"]
    assert "no such program in PATH" in told["/unknown"]["problem"]
    assert told["/long"]["problem"].endswith("File name too long")
    assert told["/unknown"]["argv"][0] == "no_such_program"
    assert told["/fine"]["problem"] is None
    text = explain(path, code=1)
    assert f"/absent ({path}:1) cannot be started" in text.stderr
    assert shlex.join(told["/fine"]["argv"]) in text.stdout


def test_components_that_are_not_installed_are_named(tmp_path: Path) -> None:
    components = [
        ("play_launch_demo", "play_launch_demo::Talker"),
        ("play_launch_demo", "play_launch_demo::Talkr"),
        ("std_msgs", "std_msgs::Talker"),
        ("nobody_has_this", "nobody_has_this::Talker"),
    ]
    nodes = [
        {"name": f"n{number}", "package": package, "plugin": plugin}
        for number, (package, plugin) in enumerate(components)
    ]
    path = tmp_path / "missing.yaml"
    program = {"package": "play_launch_container", "executable": "component_container"}
    absent = {**nodes[3], "name": "absent"}
    theirs = {"name": "theirs", "container_type": "stock", "composable_nodes": [absent], **program}
    containers = [{"name": "box", "composable_nodes": nodes}, theirs]
    path.write_text(json.dumps({"version": 1, "containers": containers}), encoding="utf-8")
    result = explain(path, "--json", code=1)
    (told, other, *_) = json.loads(result.stdout)["processes"]
    assert (other["name"], other["problem"], other["unloadable"]) == ("/theirs", None, [])
    problems = {each["name"]: each["problem"] for each in told["unloadable"]}
    assert problems.keys() == {"/n1", "/n2", "/n3"}
    assert problems["/n1"].endswith("did you mean play_launch_demo::Talker?")
    assert problems["/n2"] == f"package std_msgs in {sys.prefix} has no components"
    assert problems["/n3"].startswith("package nobody_has_this is not installed")
    for name, problem in problems.items():
        assert f"{name} ({path}:1) cannot be loaded: {problem}" in result.stderr
