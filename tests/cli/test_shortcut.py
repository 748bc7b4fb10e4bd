"""Plain command lines mean the same to the shortcut as to typer."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
from hypothesis import given, settings
from hypothesis import strategies as st

from play_launch.cli.app import app
from play_launch.cli.shortcut import plain_parameters
from play_launch.launch_files.configuration.options import Containers

VERBS = ("replay", "check", "launch", "dump")
OPTIONS = [
    "--json",
    "--explain",
    "--quiet",
    "-q",
    "-qq",
    "--log-dir",
    "--log-dir=x",
    "--duration",
    "--log",
    "-h",
    "--container-type",
    "--strict",
    "-s",
    "-n",
    "-o",
    "--timeout",
    "--launch-prefix",
    "-a",
]
VALUES = [
    "a.yaml",
    "x:=1",
    "y:=",
    "b.yaml",
    "../x",
    "~/y",
    "$HOME",
    "10s",
    "stock",
    "-5s",
    "",
    "-",
    "--",
]
WORDS = st.sampled_from(OPTIONS) | st.sampled_from(VALUES)


def by_typer(verb: str, arguments: list[str]) -> dict[str, Any]:
    group: Any = typer.main.get_command(app)
    context = group.make_context("play-launch", [verb, *arguments])
    command = group.get_command(context, verb)
    made = command.make_context(verb, list(arguments), parent=context)
    return {
        name: list(value) if name in {"arguments", "target"} else value
        for name, value in made.params.items()
        if made.get_parameter_source(name).name == "COMMANDLINE"
    }


@pytest.mark.parametrize("verb", VERBS)
@settings(deadline=None)
@given(arguments=st.lists(WORDS, max_size=7))
def test_the_shortcut_means_what_typer_means(verb: str, arguments: list[str]) -> None:
    found = plain_parameters(verb, arguments)
    if found is not None:
        assert found == by_typer(verb, arguments)


def test_what_is_usual_is_plain() -> None:
    assert plain_parameters("check", ["a.yaml", "--json"]) == {
        "config": Path("a.yaml"),
        "as_json": True,
    }
    assert plain_parameters("check", ["a.yaml", "side:=left", "x:="]) == {
        "config": Path("a.yaml"),
        "arguments": ["side:=left", "x:="],
    }
    usual = ["a.yaml", "--log-dir", "/l", "--duration", "10s", "-q", "--json"]
    assert plain_parameters("replay", usual) == {
        "config": Path("a.yaml"),
        "log_dir": Path("/l"),
        "duration": "10s",
        "quiet": True,
        "as_json": True,
    }


def test_launch_files_are_given_as_plainly() -> None:
    words = ["demo", "a.launch.py", "x:=1"]
    assert plain_parameters("dump", [*words, "-o", "a.yaml", "--inline"]) == {
        "target": words,
        "output": Path("a.yaml"),
        "inline": True,
    }
    assert plain_parameters("launch", [*words, "-n", "--container-type", "stock"]) == {
        "target": words,
        "dry_run": True,
        "container_type": Containers.STOCK,
    }
    assert plain_parameters("launch", [*words, "--container-type", "wrong"]) is None


@pytest.mark.parametrize("arguments", [[], ["--help"], ["a.yaml", ""], ["a.yaml", "--bogus"]])
def test_the_rest_is_typers(arguments: list[str]) -> None:
    assert all(plain_parameters(verb, arguments) is None for verb in VERBS)


def test_a_check_needs_neither_typer_nor_ros(tmp_path: Path) -> None:
    path = tmp_path / "small.yaml"
    path.write_text("version: 1\ncontainers: [{name: c}]\n", encoding="utf-8")
    program = (
        "import os, sys\n"
        "from play_launch.cli.entry import main\n"
        "os._exit = sys.exit\n"
        "try:\n    main()\nexcept SystemExit as end:\n    assert end.code == 0\n"
        "print(sorted({'typer', 'rich', 'rclpy', 'asyncio', 'mcap'} & set(sys.modules)))\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", program, "check", str(path)],
        check=True,
        capture_output=True,
        text=True,
    )
    assert result.stdout.splitlines()[-1] == "[]"
