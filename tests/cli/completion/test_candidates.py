"""What is offered at a cursor, for all verbs, without a session."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.cli.completion.candidates import candidates, place_of
from play_launch.cli.completion.commands import Command, program
from play_launch.cli.completion.line import read_line
from play_launch.cli.verbs import VERBS
from play_launch.control.sessions import Seen
from tests.support.replay import COMMAND


def row(name: str, kind: str, container: str | None = None) -> dict[str, Any]:
    return {"name": name, "kind": kind, "container": container, "state": "running"}


ROWS = [
    row("/chat", "container"),
    row("/talker", "component", "/chat"),
    row("/sensing/front/camera", "component", "/chat"),
    row("/sensing/front/lidar", "component", "/chat"),
    row("/sensing/driver", "process"),
    row("/[unnamed]", "process"),
]
SEEN = [Seen(11, "/logs/one-robot", "robot", ROWS), Seen(12, "/logs/two", "second", [])]


def look(operation: str, names: Sequence[str]) -> list[Seen]:
    if operation == "ps":
        return SEEN
    known = [{"name": "/talker", "parameters": ["rate", "text", "use_sim_time"]}]
    return [Seen(11, "/logs/one-robot", "robot", known if names == ("/talker",) else [])]


def offered(line: str) -> list[str]:
    read = read_line(line)
    place = place_of(read.words[1:], read.current, program())
    return [] if place is None else [each.word for each in candidates(place, look)]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("re", ["replay", "restart", "reload", "report", "rerun", "recover"]),
        ("--v", ["--version"]),
        ("nonsense ", []),
        ("wait --for ", ["loaded", "ready", "active"]),
        ("wait --for=a", ["--for=active"]),
        ("logs --level e", ["error"]),
        ("param ", ["get", "set", "dump"]),
        ("param get --session", ["--session"]),
        ("daemon st", ["start", "stop", "status"]),
        ("check --format ", ["text", "mermaid"]),
        ("completion ", ["bash", "zsh", "fish"]),
        ("stop ", ["/chat", "/sensing/driver", "/[unnamed]"]),
        ("stop /chat ", ["/sensing/driver", "/[unnamed]"]),
        ("stop --timeout 5 /c", ["/chat"]),
        ("load /t", ["/talker"]),
        ("ps tal", ["talker"]),
        ("ps cam", ["camera"]),
        ("ps /chat:/t", ["/chat:/talker"]),
        ("ps /sensing/f", ["/sensing/front/camera", "/sensing/front/lidar", "/sensing/front/*"]),
        ("ps '/sensing/*r", ["/sensing/front/camera", "/sensing/front/lidar", "/sensing/driver"]),
        ("ps /*cam", ["/sensing/front/camera"]),
        ("param dump /sensing/front/", ["/sensing/front/camera", "/sensing/front/lidar"]),
        ("param get /talker ", ["rate", "text", "use_sim_time"]),
        ("param get --timeout 3 /talker rate ", ["text", "use_sim_time"]),
        ("param set /talker ra", ["rate"]),
        ("param set /talker rate ", []),
        ("param get /chat ", []),
        ("param get --session second /talker ", []),
        ("events --kind co", ["component", "container"]),
        ("inspect --level=w", ["--level=warn"]),
        ("export --format pe", ["perfetto"]),
        ("layout ", ["foxglove", "plotjuggler"]),
        ("signal US", ["USR1", "USR2"]),
        ("signal USR1 /ch", ["/chat"]),
        ("ps --session ", ["robot", "11", "second", "12"]),
        ("ps --session=r", ["--session=robot"]),
        ("ps --session second /", []),
        ("ps --session=11 /ch", ["/chat"]),
        ("ps --session /logs/one-robot/ /ch", ["/chat"]),
        ("ps -- --", []),
        ("replay --js", ["--json"]),
        ("inspect a.mcap --s", ["--since"]),
        ("snapshot x", []),
    ],
)  # fmt: skip
def test_what_is_offered(line: str, expected: list[str]) -> None:
    assert offered(f"play-launch {line}") == expected


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        ("replay ", "files"),
        ("replay robot", "files"),
        ("check --json ", "files"),
        ("apply ", "launch file"),
        ("launch --timeout 1s pkg ", "launch file"),
        ("replay --log-dir ", "folders"),
        ("replay --log-dir=x", "folders"),
        ("inspect ", "files"),
        ("top --svg ", "files"),
        ("export a.mcap ", "words"),
        ("replay a.yaml ", "words"),
    ],
)
def test_where_files_are_offered(line: str, kind: str) -> None:
    read = read_line(f"play-launch {line}")
    place = place_of(read.words[1:], read.current, program())
    assert place is None or place.value.kind == kind
    assert place is not None or kind == "words"


def each_command(command: Command, path: tuple[str, ...]) -> list[tuple[tuple[str, ...], Command]]:
    below = [each_command(make(), (*path, name)) for name, make in command.verbs.items()]
    return [(path, command), *(each for found in below for each in found)]


COMMANDS = each_command(program(), ())


def test_all_verbs_are_there() -> None:
    assert {path[0] for path, _ in COMMANDS if path} == set(VERBS)


@pytest.mark.parametrize("path", [("replay",), ("wait",), ("param", "get"), ("topic", "list")])
def test_the_options_are_those_of_the_help(path: tuple[str, ...]) -> None:
    command = dict(COMMANDS)[path]
    help_ = subprocess.run(
        [COMMAND, *path, "--help"], check=True, capture_output=True, text=True
    ).stdout
    known = {name for option in command.options for name in option.names if name[:2] == "--"}
    assert known - {"--session"} == set(re.findall(r"--[a-z-]+", help_)) - {"--session"}


WORDS = st.sampled_from(
    [name for path, command in COMMANDS for option in command.options for name in option.names]
    + [*VERBS, "--", "-", "", "/talker", "/*", "robot", "--session", "--for=", "get", "x:=1"]
)


@given(st.lists(WORDS, max_size=5), WORDS)
def test_whatever_stands_before_what_is_offered_continues_it(words: list[str], last: str) -> None:
    place = place_of(words, last, program())
    if place is None or place.value.kind in {"files", "folders"}:
        return
    found = [each.word for each in candidates(place, look)]
    assert len(found) == len(set(found))
    assert all(each.startswith(last) or fnmatchcase(each, f"{last}*") for each in found)
