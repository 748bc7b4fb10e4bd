"""A running system gets another configuration: the real command, containers, DDS, under traffic."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from benchmarks import correspondence
from benchmarks.correspondence import Letters, noticed
from tests.support.replay import COMMAND, Replay, replaying
from tests.support.waiting import until

RATE = 10.0
"""Messages of a node in a second."""


def write(path: Path, system: dict[str, Any]) -> Path:
    # YAML holds JSON.
    path.write_text(json.dumps(system), encoding="utf-8")
    return path


def command(replay: Replay, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [COMMAND, *arguments, "--session", str((replay.log_dir / "latest").resolve())],
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    )


def pids(replay: Replay) -> dict[str, int]:
    rows = json.loads(command(replay, "ps", "--json").stdout)
    return {row["name"]: row["pid"] for row in rows}


def all_loaded(replay: Replay, count: int) -> None:
    loaded: set[str] = set()

    def done(event: dict[str, Any]) -> bool:
        if event["event"] == "node" and event["state"] == "loaded":
            loaded.add(event["node"])
        return len(loaded) == count

    replay.read_until(done, f"{count} nodes loaded")
    # A session can be operated a moment after its start.
    until(lambda: command(replay, "ps").returncode == 0, "a session that answers")


def test_what_is_not_changed_runs_on_and_loses_no_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = correspondence.nodes(RATE)
    config = write(tmp_path / "system.yaml", correspondence.system(before))
    after = correspondence.changed(before, RATE)
    target = write(tmp_path / "target.yaml", correspondence.system(after))
    intact = correspondence.untouched()
    with correspondence.figures() as figures:
        for name, value in figures.environment.items():
            monkeypatch.setenv(name, value)

        def hear_more(numbers: list[int]) -> dict[int, Letters]:
            """Wait until each of these heard ten messages more."""
            least = {n: each.heard + 10 for n, each in noticed(figures, numbers).items()}
            until(
                lambda: all(noticed(figures, [n])[n].heard >= least[n] for n in numbers),
                f"messages to {numbers}",
            )
            return noticed(figures, numbers)

        with replaying(config, tmp_path / "logs") as replay:
            all_loaded(replay, len(before))
            start = hear_more(list(before))
            assert all(each.missing == each.began_anew == 0 for each in start.values())
            pids_before = pids(replay)
            found = command(replay, "diff", target, "--json")
            assert found.returncode == 1, found.stderr
            assert {
                (step["name"], step["action"]) for step in json.loads(found.stdout)["steps"]
            } == {
                ("/standard:/node3", "set"),
                ("/isolated:/node7", "reload"),
                ("/isolated_mt:/node11", "remove"),
                ("/standard:/node30", "add"),
            }
            applied = command(replay, "apply", target)
            assert applied.returncode == 0, applied.stderr
            assert "/standard:/node3: set done" in applied.stdout

            end = hear_more([*intact, correspondence.ADDED])
            for number in intact:
                assert end[number].pid == start[number].pid
                assert (end[number].missing, end[number].began_anew) == (0, 0), number
            # It is seen where there is something to see: one was loaded anew, one is silent.
            (reloaded,) = hear_more([8]).values()
            assert reloaded.began_anew == 1
            silent = noticed(figures, [12])[12].heard
            hear_more(intact)
            assert noticed(figures, [12])[12].heard == silent

            pids_after = pids(replay)
            kept = pids_before.keys() - {"/node7", "/node11"}
            assert {name: pids_after[name] for name in kept} == {
                name: pids_before[name] for name in kept
            }
            assert pids_after.keys() - pids_before.keys() == {"/node30"}
            note = command(replay, "param", "get", "/node3", "note", "--json")
            assert json.loads(note.stdout) == {"note": "changed"}

            again = command(replay, "diff", target)
            assert (again.returncode, again.stdout) == (0, "nothing differs\n")
            assert command(replay, "apply", target).returncode == 0
            assert pids(replay) == pids_after
    with replay.bag.open("rb") as file:
        attached = {each.name: each.data for each in make_reader(file).iter_attachments()}
    assert attached["applied/1/config.yaml"] == target.read_bytes()
    assert json.loads(attached["applied/1/resolved_config.json"])["containers"]
    assert "applied/2/config.yaml" not in attached, "nothing was applied the second time"


SMALL = """
version: 1
containers:
  - name: box
    container_type: isolated
    composable_nodes:
      - {package: play_launch_demo, plugin: "play_launch_demo::Talker", name: first}
nodes:
  - {name: sleeper, command: [sleep, "600"]}
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(SMALL, encoding="utf-8")
    return path


def edited(path: Path, old: str, new: str) -> Path:
    assert old in SMALL
    target = path.with_name("edited.yaml")
    target.write_text(SMALL.replace(old, new), encoding="utf-8")
    return target


def test_a_failure_says_how_far_it_came_and_can_be_rolled_back(tmp_path: Path, small: Path) -> None:
    with replaying(small, tmp_path / "logs") as replay:
        all_loaded(replay, 1)
        before = pids(replay)
        line = next(each for each in SMALL.splitlines(keepends=True) if "first" in each)
        bad = line.replace("Talker", "NoSuchClass").replace("first", "second")
        target = edited(small, line, line + bad)
        failed = command(replay, "apply", target)
        assert failed.returncode == 1
        assert "/box:/second" in failed.stderr
        assert "0 of 1 steps are done" in failed.stderr
        assert pids(replay).items() >= before.items()
        # The failed node is what is left to do.
        left = json.loads(command(replay, "diff", target, "--json").stdout)
        assert [(each["name"], each["action"]) for each in left["steps"]] == [
            ("/box:/second", "load")
        ]
        assert command(replay, "apply", small).returncode == 0
        back = command(replay, "apply", target, "--rollback-on-failure")
        assert back.returncode == 1
        assert "rolled back" in back.stderr
        assert pids(replay) == before
        assert command(replay, "diff", small).returncode == 0


def test_a_process_with_another_command_is_another_process(tmp_path: Path, small: Path) -> None:
    with replaying(small, tmp_path / "logs") as replay:
        all_loaded(replay, 1)
        before = pids(replay)
        done = command(replay, "apply", edited(small, '"600"', '"601"'))
        assert done.returncode == 0, done.stderr
        after = pids(replay)
        assert after["/sleeper"] != before["/sleeper"]
        assert after["/first"] == before["/first"]
        assert after["/box"] == before["/box"]


def test_mistakes_are_found_before_anything_is_asked(tmp_path: Path, small: Path) -> None:
    with replaying(small, tmp_path / "logs") as replay:
        all_loaded(replay, 1)
        before = pids(replay)
        target = edited(small, "name: box", "nmae: box")
        for verb in ("diff", "apply"):
            refused = command(replay, verb, target)
            assert refused.returncode == 2
            assert "edited.yaml:4:" in refused.stderr
        assert pids(replay) == before


def test_without_a_session_diff_reports_an_error_and_no_difference(
    tmp_path: Path, small: Path
) -> None:
    result = subprocess.run(
        [COMMAND, "diff", small, "--session", tmp_path],
        check=False,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 2
    assert "no session" in result.stderr


def test_a_file_that_is_watched_is_applied_when_it_is_saved(tmp_path: Path, small: Path) -> None:
    with replaying(small, tmp_path / "logs", "--watch", "--duration", "600s") as replay:
        all_loaded(replay, 1)
        before = pids(replay)
        line = next(each for each in SMALL.splitlines(keepends=True) if "first" in each)
        small.write_text(SMALL.replace("version: 1", "version: one"), encoding="utf-8")
        replay.read_until(
            lambda event: event["event"] == "log" and "is not applied" in event["message"],
            "the mistakes",
        )
        small.write_text(SMALL + "# a remark\n", encoding="utf-8")
        edit = SMALL.replace(line, line + line.replace("first", "second"))
        small.with_name("new.yaml").write_text(edit, encoding="utf-8")
        small.with_name("new.yaml").replace(small)
        replay.read_until_states({"/second": "loaded"})
        assert pids(replay).items() >= before.items()
        # Copied in place, with the times of the original.
        times = small.stat()
        small.write_text(edit.replace("second", "fourth"), encoding="utf-8")
        os.utime(small, ns=(times.st_atime_ns, times.st_mtime_ns))
        replay.read_until_states({"/fourth": "loaded"})
        # The duration that the command line gave is no difference.
        assert command(replay, "diff", small).returncode == 0


def test_a_recording_is_not_watched(tmp_path: Path) -> None:
    result = subprocess.run(
        [COMMAND, "replay", tmp_path / "session.mcap", "--watch"],
        check=False,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 2
    assert "leave out --watch" in result.stderr
