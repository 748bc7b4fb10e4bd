from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from play_launch import ExitCode
from play_launch.cli.app import COMMANDS, app, command_of
from play_launch.container import ros
from play_launch.control.event_words import EVENT_TYPES
from tests.support.replay import finished, run

runner = CliRunner()

GOOD = """
version: 1
containers:
  - name: c
    composable_nodes:
      - {package: p, plugin: "p::N", name: n, parameters: {rate: 2.0, raw: [1, 2]}}
      - {package: p, plugin: "p::N", name: m}
"""
_READERS = ("inspect", "report", "explain", "crashes", "compare", "rerun", "recover", "export")
USED_BY = (
    dict.fromkeys((*_READERS, "layout"), ("play_launch.cli.info",))
    | dict.fromkeys(("inspect", "report"), ("play_launch.cli.info", "play_launch.cli.explain"))
    | {"graph": ("play_launch.cli.node",)}
)
"""Modules of other commands that a command uses."""
BAD = "version: 1\ncontainers:\n  - nmae: c\n"


@pytest.fixture
def good(tmp_path: Path) -> Path:
    path = tmp_path / "good.yaml"
    path.write_text(GOOD, encoding="utf-8")
    return path


@pytest.fixture
def bad(tmp_path: Path) -> Path:
    path = tmp_path / "bad.yaml"
    path.write_text(BAD, encoding="utf-8")
    return path


def test_help_says_what_there_is_and_gives_examples() -> None:
    result = runner.invoke(app, ["--help"], prog_name="play-launch")
    assert result.exit_code == 0
    for word in ("replay", "check", "version", "Examples:", "Exit codes:"):
        assert word in result.output
    bare = runner.invoke(app, [], prog_name="play-launch")
    assert bare.exit_code == 2
    assert "Examples:" in bare.output


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_has_help(name: str) -> None:
    result = runner.invoke(app, [name, "-h"])
    assert result.exit_code == 0, result.output
    assert f" {name} " in result.output


def test_no_line_of_any_help_is_cut_at_80_columns() -> None:
    def walk(command: Any, words: list[str]) -> None:
        shown = runner.invoke(app, [*words, "--help"], env={"COLUMNS": "80"})
        assert shown.exit_code == 0, words
        _, _, below_usage = shown.output.partition("\n\n")
        for line in below_usage.splitlines():
            assert len(line) <= 80, (words, line)
            assert not re.search(r"[a-z]\.\.\.$", line), (words, line)
        assert not re.search(r"default: \(|\\|range>", shown.output), words
        for name in getattr(command, "commands", ()):
            walk(command.commands[name], [*words, name])

    walk(None, [])
    for each in COMMANDS.values():
        walk(command_of(each), [each.name])


def test_the_help_of_events_names_every_kind() -> None:
    shown = runner.invoke(app, ["events", "--help"], env={"COLUMNS": "80"}).output
    assert {*EVENT_TYPES.values()} <= {*re.findall(r"\w+", shown.partition("--kind")[2])}


def test_the_manual_has_the_help_of_every_command() -> None:
    def said(*words: str) -> str:
        return runner.invoke(app, words, prog_name="play-launch", env={"COLUMNS": "80"}).output

    text, page, roff = said("manual"), said("manual", "--format", "markdown"), ""
    for part in said("manual", "--format", "man").splitlines():
        assert not part.startswith("'"), part
        assert not part.startswith(".") or part.split()[0] in {
            ".TH",
            ".SH",
            ".SS",
            ".nf",
            ".fi",
            ".in",
        }
        roff += part.removeprefix("\\&").replace("\\-", "-").replace("\\e", "\\") + "\n"
    for words in [*COMMANDS, "param set", "daemon patch"]:
        help_text = said(*words.split(), "--help")
        assert help_text in text, words
        assert f"### {words}\n\n```text\nUsage: play-launch {words} " in page
        assert f".SS {words}\n.in 0\n.nf\n{help_text}" in roff
    assert roff.index("NAME\nplay-launch - Start a whole ROS 2 system") < roff.index("Exit codes:")


def test_exit_codes_are_documented() -> None:
    page = (Path(__file__).parents[2] / "docs" / "control.md").read_text("utf-8")
    page = page.partition("## Exit codes\n")[2].partition("\n## ")[0]
    documented = {int(code) for code in re.findall(r"^\| (\d+) \|", page, re.MULTILINE)}
    assert documented == {*ExitCode} - {ExitCode.SIGNAL_BASE}


@pytest.mark.parametrize("name", COMMANDS)
def test_only_the_module_of_the_command_is_imported(name: str) -> None:
    program = (
        "import sys\n"
        "from play_launch.cli.app import main\n"
        f"sys.argv = ['play-launch', {name!r}, '--help']\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        "print(*sys.modules, file=sys.stderr)\n"
    )
    shown = finished([sys.executable, "-c", program], code=0)
    imported = set(shown.stderr.split())
    modules = {f"play_launch.cli.{each.module}" for each in COMMANDS.values()}
    own = {f"play_launch.cli.{COMMANDS[name].module}", *USED_BY.get(name, ())}
    assert imported & modules <= own
    assert not imported & {"rclpy", "rich", "textual", "argparse"}


def test_help_does_not_import_what_is_slow() -> None:
    program = (
        "import sys\n"
        "from play_launch.cli.app import main\n"
        "sys.argv = ['play-launch', '--help']\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        "slow = {'pydantic', 'rclpy', 'mcap', 'psutil', 'yaml', 'asyncio'} & set(sys.modules)\n"
        "print(sorted(slow), file=sys.stderr)\n"
    )
    result = finished([sys.executable, "-c", program], code=0)
    assert result.stderr.strip() == "[]"


def test_a_similar_verb_is_proposed() -> None:
    result = runner.invoke(app, ["repla"], prog_name="play-launch")
    assert result.exit_code == 2
    assert "'replay'" in result.stderr


def test_version_is_told_for_people_and_machines() -> None:
    people = runner.invoke(app, ["version"])
    assert people.exit_code == 0
    assert people.output.startswith("play-launch ")
    machines = runner.invoke(app, ["version", "--json"])
    assert json.loads(machines.output)["python"]
    assert runner.invoke(app, ["--version"]).output == people.output


def test_check_accepts_a_good_configuration(good: Path) -> None:
    result = runner.invoke(app, ["check", str(good)])
    assert (result.exit_code, result.output) == (0, f"{good}: 1 container with 2 nodes\n")
    values = json.loads(runner.invoke(app, ["check", "--json", str(good)]).output)
    assert values["valid"] is True
    node = values["config"]["containers"][0]["composable_nodes"][0]
    assert node["full_name"] == "/n"
    parameters = node["parameters"]
    assert parameters["rate"] == {"type": "double", "value": 2.0}
    assert parameters["raw"] == {"type": "integer_array", "value": [1, 2]}
    assert "text" not in values["config"]


def test_check_names_the_place_of_a_mistake(bad: Path) -> None:
    result = runner.invoke(app, ["check", str(bad)])
    assert result.exit_code == 2
    assert result.stdout == ""
    assert f"{bad}:3:5: containers[0]" in result.stderr
    values = json.loads(runner.invoke(app, ["check", "--json", str(bad)]).stdout)
    assert values["valid"] is False
    assert {(problem["line"], problem["file"]) for problem in values["problems"]} == {(3, str(bad))}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--duration", "soon"], "'--duration': expected a duration"),
        (["--duration", "0"], "'--duration': must be longer than 0 s"),
        (["--duration", "-1s"], "'--duration': a duration cannot be negative"),
        (["--log-dir", "{file}"], "choose another place"),
    ],
)
def test_wrong_usage_is_a_sentence(
    good: Path, tmp_path: Path, arguments: list[str], words: str
) -> None:
    (tmp_path / "file").write_text("")
    given = [each.format(file=tmp_path / "file") for each in arguments]
    result = runner.invoke(app, ["replay", str(good), *given])
    assert result.exit_code == 2
    assert words in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize("missing", ["ros_installation", "component_container", "spawn_guard"])
def test_what_is_not_installed_is_a_sentence(
    good: Path, missing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> None:
        raise ros.NotInstalledError("it is not there: install it")

    monkeypatch.setattr(ros, missing, refuse)
    result = runner.invoke(app, ["replay", str(good)])
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == "error: it is not there: install it\n"


def test_a_ros_for_another_python_is_a_sentence(
    good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros, "rclpy_problem", lambda: "there is no package rclpy")
    result = runner.invoke(app, ["replay", str(good)])
    assert (result.exit_code, result.stdout) == (2, "")
    assert "ROS does not work in this Python: there is no package rclpy. Source" in result.stderr


@pytest.mark.parametrize(
    "arguments", [["version"], ["check", "{good}"], ["check", "--json", "{good}"]]
)
def test_a_reader_that_has_gone_is_no_error(good: Path, arguments: list[str]) -> None:
    given = [each.format(good=good) for each in arguments]
    ours, theirs = os.pipe()
    os.close(ours)
    try:
        result = subprocess.run(
            [sys.executable, "-c", "from play_launch.cli.app import main; main()", *given],
            check=False,
            stdout=theirs,
            stderr=subprocess.PIPE,
            text=True,
        )
    finally:
        os.close(theirs)
    assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.parametrize("verb", ["check", "replay"])
def test_thousands_of_mistakes_do_not_flood_the_screen(verb: str, tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text("version: 1\nnodes:\n" + "  - {comand: [x]}\n" * 3_000, encoding="utf-8")
    done = run(verb, config)
    assert done.returncode == 2
    assert len(done.stderr) < 20_000
    count = re.search(r"and ([\d,]+) more; play-launch check --json lists them all", done.stderr)
    assert count is not None
    every = run("check", "--json", config)
    problems = json.loads(every.stdout)["problems"]
    assert len(problems) == 50 + int(count[1].replace(",", ""))


def test_the_same_choices_are_listed_once(tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text(
        "version: 1\nnodes:\n" + "  - {command: [x], oddity: 1}\n" * 3 + "odd: 1\nrare: 1\n"
    )
    lines = run("check", config).stderr.splitlines()[1:]
    keys = [line.partition("unknown key ")[2].partition(";")[::2] for line in lines]
    assert [(key, bool(choices)) for key, choices in keys] == [
        ('"oddity"', True),
        ('"oddity"', False),
        ('"oddity"', False),
        ('"odd"', True),
        ('"rare"', False),
    ]
    every = json.loads(run("check", "--json", config).stdout)["problems"]
    assert all("; known here: " in problem["message"] for problem in every)


@pytest.mark.parametrize("home", [None, ""])
def test_without_a_folder_for_ros_s_log_nothing_is_started(
    home: str | None, tmp_path: Path
) -> None:
    config = tmp_path / "c.yaml"
    config.write_text("version: 1\nduration: 1 s\ncontainers: [{name: c}]\n", encoding="utf-8")
    without = {"HOME", "ROS_HOME", "ROS_LOG_DIR"}
    environ = {name: value for name, value in os.environ.items() if name not in without}
    if home is not None:
        environ["HOME"] = home

    def replay(**more: str) -> subprocess.CompletedProcess[str]:
        return run("replay", config, "--log-dir", tmp_path / "logs", env={**environ, **more})

    done = replay()
    assert done.returncode == 2
    assert done.stderr.count("set HOME or ROS_LOG_DIR") == 1
    assert not (tmp_path / "logs").exists()
    (tmp_path / "file").touch()
    done = replay(ROS_LOG_DIR=str(tmp_path / "file" / "logs"))
    assert done.returncode == ExitCode.USAGE
    assert f"{tmp_path / 'file'} is not writable; set ROS_LOG_DIR" in done.stderr
    assert replay(ROS_LOG_DIR=str(tmp_path / "ros")).returncode == 0


def test_a_time_zone_that_no_clock_can_have_will_do(tmp_path: Path) -> None:
    config, logs = tmp_path / "c.yaml", tmp_path / "logs"
    config.write_text("version: 1\nnodes: [{command: [sh, -c, kill -SEGV $$]}]\n", "utf-8")
    environ = {**os.environ, "TZ": "XYZ+99999"}
    assert run("replay", config, "--log-dir", logs, env=environ).returncode == 1
    for verb, words in (("info", "Start"), ("crashes", "1 time in 1 session, at 20")):
        assert words in run(verb, logs / "latest", env=environ, code=0).stdout
