"""Included files, parameter files and arguments in ``replay --watch``, ``diff`` and ``apply``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration.test_apply import all_loaded
from tests.support.replay import Replay, replaying

MAIN = """
version: 1
include: parts/box.yaml
containers:
  - name: box
    composable_nodes:
      - name: first
        parameters: [values.yaml]
"""
BOX = """
version: 1
containers:
  - name: box
    container_type: isolated
    composable_nodes:
      - package: play_launch_demo
        plugin: "play_launch_demo::Talker"
        name: first
        parameters: {text: "${arg:greeting:-nothing} from a part"}
"""
VALUES = "/**:\n  ros__parameters: {rate: 20.0}\n"
SECOND = """
version: 1
containers:
  - name: more
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: other}
"""


@pytest.fixture
def main(tmp_path: Path) -> Path:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "box.yaml").write_text(BOX, encoding="utf-8")
    (tmp_path / "values.yaml").write_text(VALUES, encoding="utf-8")
    path = tmp_path / "main.yaml"
    path.write_text(MAIN, encoding="utf-8")
    return path


def parameters(replay: Replay) -> dict[str, Any]:
    found = json.loads(replay.ask("param", "dump", "/first", "--json").stdout)
    values: dict[str, Any] = found["/first"]
    return values


def steps(replay: Replay) -> Iterator[str]:
    """What is applied by and by, in the words of the events."""
    while True:
        event = replay.read_until(
            lambda event: (
                (event["event"] == "action" and event.get("phase") in {"done", "failed"})
                or (event["event"] == "log" and "is not applied" in event["message"])
            ),
            "something that is applied or not",
        )
        yield event["message"] if event["event"] == "log" else event["phase"]


def test_files_that_are_included_or_named_are_watched_and_arguments_stay(
    main: Path, tmp_path: Path
) -> None:
    arguments = ("greeting:=Hello", "--watch")
    with replaying(main, tmp_path / "logs", *arguments) as replay:
        all_loaded(replay, 1)
        before = replay.pids()
        assert parameters(replay)["text"] == "Hello from a part"
        happened = steps(replay)
        (tmp_path / "values.yaml").write_text(VALUES.replace("20.0", "40.0"), encoding="utf-8")
        assert next(happened) == "done"
        assert parameters(replay)["rate"] == 40.0
        part = tmp_path / "parts" / "box.yaml"
        part.write_text(BOX.replace("from a part", "again"), encoding="utf-8")
        assert next(happened) == "done"
        assert parameters(replay)["text"] == "Hello again"
        # A mistake that is mended in a file which no good configuration has named yet.
        both = MAIN.replace("parts/box.yaml", "[parts/box.yaml, parts/more.yaml]")
        main.write_text(both, encoding="utf-8")
        assert "parts/more.yaml: no such file" in next(happened)
        more = tmp_path / "parts" / "more.yaml"
        more.write_text(SECOND.replace("version: 1", "version: one"), encoding="utf-8")
        assert "parts/more.yaml:2:" in next(happened)
        more.write_text(SECOND, encoding="utf-8")
        assert next(happened) == "done"
        after = replay.pids()
        assert after["/box"] == before["/box"]
        assert "/other" in after
        # Another one of the same content is no change.
        assert replay.ask("diff", main, "greeting:=Hello").returncode == 0


def test_arguments_of_diff_and_apply(main: Path, tmp_path: Path) -> None:
    with replaying(main, tmp_path / "logs", "greeting:=Hello") as replay:
        all_loaded(replay, 1)
        before = replay.pids()
        assert replay.ask("diff", main, "greeting:=Hello").returncode == 0
        options = "--container-type", "same", "greeting:=Hello"
        assert replay.ask("diff", main, *options).returncode == 0
        found = replay.ask("diff", main)
        assert found.returncode == 1
        assert "nothing from a part" in found.stdout
        for verb in ("diff", "apply"):
            for wrong, words in (
                ("greting:=x", "nothing reads the argument greting"),
                ("x", "write name:=value"),
            ):
                refused = replay.ask(verb, main, wrong)
                assert refused.returncode == 2
                assert words in refused.stderr
        done = replay.ask("apply", main, "greeting:=It's := me")
        assert done.returncode == 0, done.stderr
        assert parameters(replay)["text"] == "It's := me from a part"
        # A node that has no time to answer is reloaded.
        assert replay.pids()["/box"] == before["/box"]
        assert replay.ask("diff", main, "greeting:=It's := me").returncode == 0
