"""A session decides once more: the real command, from a recording of real processes."""

from __future__ import annotations

import json
import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.writer import Writer

from play_launch.cli.rerun import rerun as rerun_here
from play_launch.container.cdr.messages import PARAMETER_VALUE
from play_launch.postmortem.bag_reader import BagReader
from play_launch.recording import topics
from play_launch.supervisor import process_rules
from play_launch.supervisor.outcome import decide
from tests.support.replay import replaying, run
from tests.support.waiting import until

ROOT = Path(__file__).resolve().parents[2]
TOKEN = "correct-horse-battery"
Rows = list[list[Any]]


def rerun(path: Path, *options: str) -> tuple[int, dict[str, Any]]:
    result = run("rerun", path, "--json", *options)
    return result.returncode, json.loads(result.stdout)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo, with a crash, a restart, a stop and a change, in several files."""
    folder = tmp_path_factory.mktemp("rerun")
    text = (ROOT / "configs" / "demo.yaml").read_text(encoding="utf-8")
    text = text.replace("duration: 10 s\n", "record: {rotate: {duration: 1 s}}\n")
    text = text.replace("seconds: 3.0", "seconds: 0.1")
    text += """
nodes:
  - {name: sleeper, command: [sh, -c, exec sleep 600, "${env:DEMO_TOKEN}"]}
"""
    demo, other = folder / "demo.yaml", folder / "other.yaml"
    demo.write_text(text, encoding="utf-8")
    changed = text.replace("rate: 20.0", "rate: 10.0").replace("name: echo", "name: answer")
    other.write_text(changed, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DEMO_TOKEN", TOKEN)
        with replaying(demo, folder / "logs") as replay:
            nodes = ["talker", "listener", "sensing/front", "sensing/detector"]
            nodes += ["sensing/recorder", "far_listener", "slow_starter", "echo"]
            replay.read_until_states({f"/{each}": "loaded" for each in nodes})
            replay.until_operable()
            pid = replay.pids()["/chat"]
            os.kill(pid, signal.SIGSEGV)
            replay.read_until_states({"/talker": "lost"})
            replay.read_until_states({"/talker": "loaded", "/listener": "loaded"})
            assert replay.ask("restart", "/monitor", code=0)
            assert replay.ask("stop", "sleeper", code=0)
            assert replay.ask("apply", other, code=0)
    return replay.bag.resolve().parent


def inputs_of(path: Path) -> Rows:
    found = BagReader(path).messages({topics.INPUTS.name})
    return [row for each in found for row in rows_of(each.data)]


def rows_of(data: bytes) -> Rows:
    rows: Rows = msgspec.msgpack.decode(PARAMETER_VALUE.read(data)["byte_array_value"])
    return rows


def rewritten(path: Path, target: Path, change: Callable[[Rows], Rows]) -> Path:
    """Write a recording as one file, with other inputs."""
    reader = BagReader(path)
    with target.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        channels: dict[str, int] = {}
        for message in reader.messages():
            name, data = message.topic.name, message.data
            if not channels:
                for title, values in reader.metadata.items():
                    writer.add_metadata(title, values)
            if name not in channels:
                schema = writer.register_schema(message.topic.type_name, "ros2msg", b"")
                channels[name] = writer.register_channel(name, "cdr", schema)
            if name == topics.INPUTS.name:
                packed = msgspec.msgpack.encode(change(rows_of(data)))
                data = PARAMETER_VALUE.write({"type": 5, "byte_array_value": packed})
            writer.add_message(
                channels[name], message.log_time, data, message.publish_time, message.sequence
            )
        writer.finish()
    return target


def test_a_session_follows_from_its_inputs(session: Path) -> None:
    assert len(list(session.glob("*.mcap"))) > 1
    code, found = rerun(session)
    assert (code, found["same"], found["differences"]) == (0, True, [])
    kinds = {row[4]["type"] for row in inputs_of(session)}
    assert kinds >= {"Origin", "Exited", "StartRequested", "ChangeRequested", "Over"}
    assert found["inputs"] > 50
    result = run("rerun", session)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.endswith("of state, as recorded\n")


def test_what_is_secret_is_not_in_the_inputs(session: Path) -> None:
    rows = inputs_of(session)
    started = [row[4] for row in rows if row[4]["type"] == "Started"]
    assert ["sh", "-c", "exec sleep 600", "(redacted)"] in [each["argv"] for each in started]
    assert TOKEN.encode() not in msgspec.msgpack.encode(rows)


def test_what_comes_after_a_time_is_not_compared(session: Path) -> None:
    code, found = rerun(session, "--until", "0.5s")
    assert (code, found["same"]) == (0, True)
    assert found["until_s"] <= 0.5
    assert found["inputs"] < rerun(session)[1]["inputs"]
    result = run("rerun", session, "--until", "soon")
    assert (result.returncode, result.stdout) == (2, "")
    assert "--until" in result.stderr


def test_an_input_that_is_missing_is_noticed(session: Path, tmp_path: Path) -> None:
    number = next(row[0] for row in inputs_of(session) if row[4]["type"] == "Exited")
    target = rewritten(
        session, tmp_path / "x.mcap", lambda rows: [row for row in rows if row[0] != number]
    )
    code, found = rerun(target)
    assert (code, found["same"], found["differences"]) == (5, False, [])
    assert found["incomplete"] == f"inputs {number} to {number} are missing"
    # What was before it is the same, and can be compared alone.
    assert rerun(target, "--until", f"{found['until_s'] - 0.001}s")[0] == 0


def test_an_input_of_another_version_is_named_as_such(session: Path, tmp_path: Path) -> None:
    number = next(row[0] for row in inputs_of(session) if row[4]["type"] == "Exited")

    def other(rows: Rows) -> Rows:
        for row in rows:
            if row[0] == number:
                row[4]["type"] = "Vanished"
        return rows

    code, found = rerun(rewritten(session, tmp_path / "x.mcap", other))
    assert (code, found["same"], found["differences"]) == (5, False, [])
    assert "another version recorded inputs" in found["incomplete"]


def test_other_verbs_read_it_and_one_without_inputs_is_incomplete(
    session: Path, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(session, tmp_path / "copy"))
    for verb in ("info", "inspect", "explain", "export"):
        assert run(verb, folder).returncode in ({0, 1} if verb == "explain" else {0}), verb
    last = max(folder.glob("session_*.mcap"), key=lambda path: int(path.stem.split("_")[1]))
    assert run("rerun", last).returncode == 5
    last.rename(f"{last}.active")
    assert run("recover", folder).returncode == 0
    assert rerun(folder)[0] == 0
    old = rewritten(session, tmp_path / "old.mcap", lambda _: [])
    code, found = rerun(old)
    assert (code, found["inputs"]) == (5, 0)
    assert "older version" in found["incomplete"]


def test_another_input_leads_to_something_else(session: Path, tmp_path: Path) -> None:
    exited = next(row for row in inputs_of(session) if row[4]["type"] == "Exited")

    def other(rows: Rows) -> Rows:
        for row in rows:
            if row[0] == exited[0]:
                row[4]["exit"] = {"text": "left", "code": 3}
        return rows

    target = rewritten(session, tmp_path / "other.mcap", other)
    code, found = rerun(target)
    assert code == 1
    (first,) = found["differences"]
    assert first["unit"] == "/chat"
    assert first["input"] == {"number": exited[0], "type": "Exited", "unit": "/chat"}
    assert (first["recorded"]["signal"], first["new"]["signal"]) == (signal.SIGSEGV, 0)
    assert {"signal", "exit_code", "reason"} <= set(first["fields"])
    assert first["seconds"] == pytest.approx(found["until_s"])
    assert rerun(target, "--until", f"{first['seconds'] - 0.001}s")[0] == 0
    text = run("rerun", target, "--diff")
    assert text.returncode == 1
    assert f"{first['seconds']:.3f} s: process /chat differs" in text.stdout
    assert "  signal: recorded 11, now 0\n" in text.stdout
    assert len(rerun(target, "--diff")[1]["differences"]) > 1


def test_another_rule_leads_to_something_else(
    session: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def much_later(*what: Any, **limits: Any) -> tuple[Any, float]:
        return decide(*what, **limits)[0], 3600.0

    monkeypatch.setattr(process_rules, "decide", much_later)
    assert rerun_here(session, as_json=True) == 1
    (first,) = json.loads(capsys.readouterr().out)["differences"]
    assert (first["unit"], first["input"]["type"]) == ("/chat", "Exited")
    assert first["fields"] == ["delay_ns"]


def test_a_session_that_was_killed_is_compared_as_far_as_it_came(tmp_path: Path) -> None:
    config = tmp_path / "one.yaml"
    config.write_text("version: 1\nnodes:\n  - {name: one, command: [sleep, '600']}\n", "utf-8")
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until(lambda event: event.get("kind") == "started", "a start")
        active = replay.bag.with_name("session.mcap.active")
        until(lambda: rerun(active)[1]["inputs"] > 0, "inputs in the recording")
        kept = active.rename(tmp_path / "kept.mcap.active")
        replay.process.send_signal(signal.SIGKILL)
        replay.process.wait()
    code, found = rerun(kept)
    assert (code, found["differences"], found["incomplete"]) == (5, [], "its end is missing")
