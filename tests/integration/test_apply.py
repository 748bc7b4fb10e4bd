"""A running system gets another configuration: the real command, containers, DDS, under traffic."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from benchmarks import correspondence
from benchmarks.correspondence import Letters, noticed
from tests.support.replay import COMMAND, Replay, replaying, run
from tests.support.scenes import written
from tests.support.waiting import until

RATE = 10.0
"""Messages of a node in a second."""


def all_loaded(replay: Replay, count: int) -> None:
    loaded: set[str] = set()
    while len(loaded) < count:
        loaded.add(replay.until(event="node", state="loaded")["node"])
    replay.until_operable()


def test_what_is_not_changed_runs_on_and_loses_no_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = correspondence.nodes(RATE)
    config = written(tmp_path / "system.yaml", **correspondence.system(before))
    after = correspondence.changed(before, RATE)
    target = written(tmp_path / "target.yaml", **correspondence.system(after))
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
            pids_before = replay.pids()
            found = replay.ask("diff", target, "--json")
            assert found.returncode == 1, found.stderr
            assert {
                (step["name"], step["action"]) for step in json.loads(found.stdout)["steps"]
            } == {
                ("/standard:/node3", "set"),
                ("/isolated:/node7", "reload"),
                ("/isolated_mt:/node11", "remove"),
                ("/standard:/node30", "add"),
            }
            applied = replay.ask("apply", target)
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

            pids_after = replay.pids()
            kept = pids_before.keys() - {"/node7", "/node11"}
            assert {name: pids_after[name] for name in kept} == {
                name: pids_before[name] for name in kept
            }
            assert pids_after.keys() - pids_before.keys() == {"/node30"}
            note = replay.ask("param", "get", "/node3", "note", "--json")
            assert json.loads(note.stdout) == {"note": "changed"}

            again = replay.ask("diff", target)
            assert (again.returncode, again.stdout) == (0, "nothing differs\n")
            assert replay.ask("apply", target).returncode == 0
            assert replay.pids() == pids_after
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
        before = replay.pids()
        line = next(each for each in SMALL.splitlines(keepends=True) if "first" in each)
        bad = line.replace("Talker", "NoSuchClass").replace("first", "second")
        target = edited(small, line, line + bad)
        failed = replay.ask("apply", target)
        assert failed.returncode == 1
        assert "/box:/second" in failed.stderr
        assert "0 of 1 steps are done" in failed.stderr
        assert replay.pids().items() >= before.items()
        # The failed node is what is left to do.
        left = json.loads(replay.ask("diff", target, "--json").stdout)
        assert [(each["name"], each["action"]) for each in left["steps"]] == [
            ("/box:/second", "load")
        ]
        assert replay.ask("apply", small).returncode == 0
        back = replay.ask("apply", target, "--rollback-on-failure")
        assert back.returncode == 1
        assert "rolled back" in back.stderr
        assert replay.pids() == before
        assert replay.ask("diff", small).returncode == 0


def test_a_process_with_another_command_is_another_process(tmp_path: Path, small: Path) -> None:
    with replaying(small, tmp_path / "logs") as replay:
        all_loaded(replay, 1)
        before = replay.pids()
        done = replay.ask("apply", edited(small, '"600"', '"601"'))
        assert done.returncode == 0, done.stderr
        after = replay.pids()
        assert after["/sleeper"] != before["/sleeper"]
        assert after["/first"] == before["/first"]
        assert after["/box"] == before["/box"]


def test_mistakes_are_found_before_anything_is_asked(tmp_path: Path, small: Path) -> None:
    with replaying(small, tmp_path / "logs") as replay:
        all_loaded(replay, 1)
        before = replay.pids()
        target = edited(small, "name: box", "nmae: box")
        for verb in ("diff", "apply"):
            refused = replay.ask(verb, target)
            assert refused.returncode == 2
            assert "edited.yaml:4:" in refused.stderr
        assert replay.pids() == before


def test_without_a_session_diff_reports_an_error_and_no_difference(
    tmp_path: Path, small: Path
) -> None:
    result = run("diff", small, "--session", tmp_path)
    assert result.returncode == 2
    assert "no session" in result.stderr


def test_a_file_that_is_watched_is_applied_when_it_is_saved(tmp_path: Path, small: Path) -> None:
    with replaying(small, tmp_path / "logs", "--watch", "--duration", "600s") as replay:
        all_loaded(replay, 1)
        before = replay.pids()
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
        assert replay.pids().items() >= before.items()
        # Copied in place, with the times of the original.
        times = small.stat()
        small.write_text(edit.replace("second", "fourth"), encoding="utf-8")
        os.utime(small, ns=(times.st_atime_ns, times.st_mtime_ns))
        replay.read_until_states({"/fourth": "loaded"})
        # The duration that the command line gave is no difference.
        assert replay.ask("diff", small).returncode == 0


def test_a_recording_is_not_watched(tmp_path: Path) -> None:
    result = run("replay", tmp_path / "session.mcap", "--watch")
    assert result.returncode == 2
    assert "leave out --watch" in result.stderr


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


DEAF = "trap '' INT; echo deaf; while :; do sleep 0.1; done"


def write(path: Path, text: str) -> Path:
    deaf = {"name": "deaf", "command": ["sh", "-c", f"{DEAF} {text}"]}
    return written(path, stop={"sigint": "10 min"}, nodes=[deaf])


def test_diff_says_that_a_configuration_is_being_applied(tmp_path: Path) -> None:
    before, after = write(tmp_path / "before.yaml", "# 1"), write(tmp_path / "after.yaml", "# 2")
    with replaying(before, tmp_path / "logs") as replay:
        deaf = replay.until(text="deaf")
        session = ["--session", str(replay.pid)]
        until(lambda: diff(before, *session)[0] == 0, "a session that answers")
        applying = subprocess.Popen(
            [str(COMMAND), "apply", str(after), "--timeout", "600", *session]
        )
        until(lambda: diff(before, *session)[0] == 1, "a configuration that is applied")
        said = diff(before, *session)[1], diff(before, *session, "--json")[1]
        os.kill(deaf["pid"], signal.SIGKILL)
        assert applying.wait(60) == 0
        assert f"{after} is being applied; compared with" in said[0]
        assert json.loads(said[1])["applying"] == str(after)
        assert diff(after, *session) == (0, "nothing differs\n")
        last = replay.until(text="deaf")
        os.kill(last["pid"], signal.SIGKILL)


def test_what_is_saved_meanwhile_is_applied_afterwards(tmp_path: Path) -> None:
    watched, other = write(tmp_path / "watched.yaml", "# 1"), write(tmp_path / "other.yaml", "# 2")

    with replaying(watched, tmp_path / "logs", "--watch") as replay:
        pid = replay.until(text="deaf")["pid"]
        session = ["--session", str(replay.pid)]
        until(lambda: diff(watched, *session)[0] == 0, "a session that answers")
        command = [str(COMMAND), "apply", str(other), "--timeout", "600", *session]
        applying = subprocess.Popen(command)
        until(lambda: diff(watched, *session)[0] == 1, "a configuration that is applied")
        write(watched, "# 3")
        os.kill(pid, signal.SIGKILL)
        assert applying.wait(60) == 0
        for text in ("# 2", "# 3"):
            pid = replay.until(text="deaf")["pid"]
            words = Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8").split("\0")
            assert words[2].endswith(text)
            if text == "# 2":
                replay.until(event="process", kind="stopping")
            os.kill(pid, signal.SIGKILL)


def test_of_two_that_are_asked_for_at_once_one_is_applied(tmp_path: Path) -> None:
    files = [write(tmp_path / f"{number}.yaml", f"# {number}") for number in range(3)]
    with replaying(files[0], tmp_path / "logs") as replay:
        deaf = replay.until(text="deaf")
        session = ["--session", str(replay.pid)]
        until(lambda: diff(files[0], *session)[0] == 0, "a session that answers")
        command = [str(COMMAND), "apply", "--timeout", "600", *session]
        first = subprocess.Popen([*command, str(files[1])])
        until(lambda: diff(files[0], *session)[0] == 1, "a configuration that is applied")
        second = subprocess.run(
            [*command, str(files[2])], check=False, stderr=subprocess.PIPE, text=True, timeout=60
        )
        assert second.returncode == 1
        assert "another configuration is being applied; try again" in second.stderr
        assert json.loads(diff(files[2], *session, "--json")[1])["applying"] == str(files[1])
        os.kill(deaf["pid"], signal.SIGKILL)
        assert first.wait(60) == 0
        assert diff(files[1], *session) == (0, "nothing differs\n")
        last = replay.until(text="deaf")
        os.kill(last["pid"], signal.SIGKILL)
    # Of each configuration that was applied there is a copy in the recording.
    with replay.bag.open("rb") as stream:
        copies = [each.name for each in make_reader(stream).iter_attachments()]
    copied = {each.split("/")[1] for each in copies if each.startswith("applied/")}
    assert copied == {"1"}


def diff(*words: str | Path) -> tuple[int, str]:
    done = run("diff", *words)
    return done.returncode, done.stdout
