"""What earlier recordings are good for: they start again without sources, and get upkeep."""

from __future__ import annotations

import json
import os
import shutil
import signal
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from play_launch.postmortem import upkeep
from play_launch.postmortem.bag_reader import BagReader
from play_launch.recording.environment import REDACTED
from play_launch.recording.topics import PARAMETER_EVENTS, PARAMETERS
from tests.postmortem.archive.scenes import begin_session, cut_off_session, name_of, past_session
from tests.support.replay import Replay, replaying, run
from tests.support.waiting import until

MAIN = """version: 1
include: {file: parts/box.yaml, arguments: {talker: "${arg:talker}"}}
environment:
  ROBOT_TOKEN: ${env:PL_TEST_TOKEN:-none}
nodes:
  - command: [sleep, "${env:PL_TEST_SECONDS}"]
"""
BOX = """version: 1
containers:
  - name: box
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::Talker
        name: ${arg:talker}
        parameters: [talker.yaml]
"""
OF_ALL_NODES = "/**:\n  ros__parameters: {period: 0.05}\n"
SECRET = "a-very-secret-token"


def write(robot: Path) -> Path:
    (robot / "parts").mkdir(parents=True)
    (robot / "robot.yaml").write_text(MAIN, encoding="utf-8")
    (robot / "parts" / "box.yaml").write_text(BOX, encoding="utf-8")
    (robot / "parts" / "talker.yaml").write_text(OF_ALL_NODES, encoding="utf-8")
    return robot / "robot.yaml"


def end(replay: Replay) -> None:
    replay.process.send_signal(signal.SIGINT)
    replay.read_all()


def resolved(bag: Path) -> dict[str, object]:
    with bag.open("rb") as file:
        attached = {each.name: each.data for each in make_reader(file).iter_attachments()}
    assert attached["config.yaml"] == MAIN.encode()
    assert attached["includes/0-box.yaml"] == BOX.encode()
    assert attached["parameters/0-talker.yaml"] == OF_ALL_NODES.encode()
    values = json.loads(attached["resolved_config.json"])
    assert isinstance(values, dict)
    return values


def test_a_recording_holds_all_that_a_configuration_was_made_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A name need not be text: ext4 stores bytes, and old archives unpack to Latin-1.
    robot = write(tmp_path / os.fsdecode(b"caf\xe9"))
    monkeypatch.setenv("PL_TEST_TOKEN", SECRET)
    monkeypatch.setenv("PL_TEST_SECONDS", "1000")
    with replaying(robot, tmp_path / "first", "talker:=talker") as first:
        first.read_until_states({"/talker": "loaded"})
        end(first)
    assert SECRET.encode() not in first.bag.read_bytes()
    then = resolved(first.bag)
    assert then["taken"] == {
        "arguments": {"talker": "talker"},
        "variables": {"PL_TEST_TOKEN": REDACTED, "PL_TEST_SECONDS": "1000"},
        "packages": {},
    }
    shutil.rmtree(robot.parent)
    monkeypatch.delenv("PL_TEST_SECONDS")
    with replaying(first.bag, tmp_path / "second") as second:
        second.read_until_states({"/talker": "loaded"})
        end(second)
    assert resolved(second.bag) == then
    with replaying(second.bag, tmp_path / "third", "talker:=other") as third:
        third.read_until_states({"/other": "loaded"})
        cut = third.bag.with_name("session.mcap.active").rename(tmp_path / "cut.mcap.active")
        third.process.send_signal(signal.SIGKILL)
        third.process.wait()
    with replaying(cut, tmp_path / "fourth") as fourth:
        fourth.read_until_states({"/other": "loaded"})


def check(*arguments: object, **environ: str) -> subprocess.CompletedProcess[str]:
    return run("check", *arguments, env={**os.environ, **environ})


def test_check_takes_arguments_and_says_nothing_secret(tmp_path: Path) -> None:
    robot = write(tmp_path / "robot")
    missing = check(robot)
    assert missing.returncode == 2
    assert "robot.yaml:2:53: include.arguments.talker: the argument talker is not" in missing.stderr
    assert "robot.yaml:6:22: nodes[0].command[1]: the environment variable" in missing.stderr
    assert check(robot, "talker").returncode == 2
    values = check(robot, "talker:=me", "--json", PL_TEST_SECONDS="1", PL_TEST_TOKEN=SECRET)
    assert values.returncode == 0, values.stdout
    assert SECRET not in values.stdout
    config = json.loads(values.stdout)["config"]
    assert config["environment"] == {"ROBOT_TOKEN": REDACTED}
    assert config["containers"][0]["file"].endswith("parts/box.yaml")
    named = json.loads(check(robot, "talker:=1x", "--json", PL_TEST_SECONDS="1").stdout)
    (problem,) = named["problems"]
    assert problem["included_from"] == [f"{robot}:2:17"]


SECRETIVE = """version: 1
containers:
  - name: box
    container_type: isolated
    on_crash: reload
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::Crasher
        name: victim
        parameters:
          how: "${env:PL_TEST_TOKEN}"
          after: ${env:PL_TEST_PIN}
nodes:
  - name: uploader
    command: [sh, -c, "sleep 1000; :", "${arg:api_key}", "a:${env:PL_TEST_TOKEN}@b"]
"""
KEY = "the-key-of-the-robot"
PIN = 918273.50


def test_no_message_of_a_recording_holds_what_sounds_secret(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PL_TEST_TOKEN", SECRET)
    monkeypatch.setenv("PL_TEST_PIN", f"{PIN:.2f}")
    config = tmp_path / "robot.yaml"
    config.write_text(SECRETIVE, encoding="utf-8")

    def answered(topic: str) -> bool:
        reader = BagReader(replay.bag.with_name(f"{replay.bag.name}.active"))
        return any(b"/victim\0" in each.data for each in reader.messages({topic}))

    with replaying(config, tmp_path / "logs", f"api_key:={KEY}") as replay:
        replay.read_until_states({"/victim": "loaded"})
        until(lambda: answered(PARAMETERS.name), "parameters of /victim")
        pids = replay.pids()
        command = Path(f"/proc/{pids['/uploader']}/cmdline").read_bytes()
        assert SECRET.encode() in command
        assert KEY.encode() in command
        os.kill(pids["/victim"], signal.SIGSEGV)
        replay.read_until_states({"/victim": "crashed"})
        # Its next life reports its parameters unasked.
        until(lambda: answered(PARAMETER_EVENTS.name), "an event of /victim")
        feed = replay.ask("events", "--json").stdout
        end(replay)
    reader = BagReader(replay.bag)
    found = [(each.topic.name, each.data) for each in reader.messages()]
    assert {PARAMETERS.name, "/play_launch/states"} <= {topic for topic, _ in found}
    number = struct.pack("<d", PIN)
    assert not [topic for topic, data in found if number in data]
    assert str(PIN).encode() not in reader.attachments["resolved_config.json"].data
    for secret in (SECRET, KEY, str(PIN)):
        assert not [topic for topic, data in found if secret.encode() in data]
        assert secret not in feed
        assert secret not in json.dumps(replay.seen)
    assert "/uploader" in feed
    said = run("explain", replay.bag, "--json")
    assert '"how"' in said.stdout
    report = tmp_path / "page.html"
    assert run("report", replay.bag, "-o", report).returncode == 0
    shown = said.stdout + report.read_text(encoding="utf-8")
    assert SECRET not in shown
    assert str(PIN) not in shown


AT_ONCE = (
    sys.executable,
    "-c",
    (
        "from play_launch.cli import entry\n"
        "from play_launch.postmortem import upkeep\n"
        "upkeep.REST = 0.0; entry.main()"
    ),
)
"""The command, as installed, but for the rest between the bring-up and the first look."""
CONFIG = """version: 1
record: {{ros: false, keep: {keep}}}
nodes: [{{name: idle, command: [sleep, "300"]}}]
"""


def configuration(folder: Path, keep: str) -> Path:
    file = folder / "robot.yaml"
    file.write_text(CONFIG.format(keep=keep), encoding="utf-8")
    return file


def about(word: str) -> Any:
    def wanted(event: dict[str, Any]) -> bool:
        is_ours = event["event"] == "log" and event["name"] == upkeep.__name__
        return is_ours and str(event["message"]).startswith(word)

    return wanted


def test_a_run_keeps_to_its_limits_and_completes_what_was_cut_off(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    for day in (1, 2, 4):
        past_session(logs, day)
    pinned = past_session(logs, 3)
    (pinned / "note.txt").write_text("look at this one", encoding="utf-8")
    cut_off = cut_off_session(logs, 5)
    running, writer = begin_session(logs, 6)
    with replaying(configuration(tmp_path, "{sessions: 3}"), logs, program=AT_ONCE) as replay:
        removed = replay.read_until(about("removed "), "that something is removed")
        recovered = replay.read_until(about("recovered "), "that something is completed")
        kept = {path.name for path in logs.iterdir()}
        assert replay.process.poll() is None
    writer.close()
    assert removed["message"].startswith("removed 3 sessions")
    assert "the latest of them 2026-11-04" in removed["message"]
    own = (logs / "latest").resolve().name
    # Three count: the run's own, the other one that runs, and the latest of the rest.
    assert kept == {pinned.name, cut_off.name, running.name, own, "latest", ".order"}
    assert "recovered the recording of 1 session" in recovered["message"]
    assert name_of(5) in recovered["message"]
    reader = BagReader(cut_off / "session.mcap")
    assert len(list(reader.messages())) == 10
    assert reader.is_complete
    assert not (cut_off / "session.mcap.active").exists()
    # What it did is in its own recording, too.
    texts = b"".join(message.data for message in BagReader(replay.bag).messages())
    assert b"removed 3 sessions" in texts


def test_a_run_without_limits_removes_nothing(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    for day in (1, 2):
        past_session(logs, day)
    cut_off_session(logs, 3)
    with replaying(configuration(tmp_path, "{}"), logs, program=AT_ONCE) as replay:
        replay.read_until(about("recovered "), "that something is completed")
    assert {name_of(day) for day in (1, 2, 3)} < {path.name for path in logs.iterdir()}
