"""The main job, run as a user runs it: real containers, real DDS, real signals."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import psutil
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from std_msgs.msg import String

from tests.support.replay import COMMAND, Replay, alive, replaying
from tests.support.ros import Probe
from tests.support.shared_memory import ports_left_in

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "configs" / "demo.yaml"

LOADED, UNLOADED, LOAD_FAILED, CRASHED, LOADING = range(5)
STARTED, READY, STOPPING, EXITED = "started", "ready", "stopping", "exited"
GAVE_UP = "gave_up"
PROCESS = 2


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def read_bag(path: Path) -> dict[str, list[Any]]:
    """All messages by topic, read by code that is not ours."""
    found: dict[str, list[Any]] = {}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append(message)
    return found


def all_loaded(count: int) -> Any:
    seen: Counter[str] = Counter()

    def done(event: dict[str, Any]) -> bool:
        seen["loaded"] += event["event"] == "component" and event["kind"] == "loaded"
        return seen["loaded"] == count

    return done


def test_the_demo_runs_talks_and_stops_and_its_recording_tells_the_story(tmp_path: Path) -> None:
    with replaying(DEMO, tmp_path) as replay:
        replay.read_until(all_loaded(8), "8 nodes loaded")
        started = replay.descendants()
        with Probe("far_away") as probe:
            texts = [message.data for message in probe.collect(String, "/chatter", count=3)]
        assert all(text.startswith("Hello from one process: ") for text in texts)
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()

    summary = replay.seen[-1]
    assert replay.process.returncode == 128 + signal.SIGINT
    assert summary["event"] == "summary"
    assert summary["recording"]["path"].endswith("session.mcap")
    assert not alive(started)

    bag = read_bag(replay.bag)
    events = bag["/play_launch/events"]
    by_node: dict[str, list[int]] = {}
    for event in events:
        by_node.setdefault(event.full_node_name, []).append(event.event_type)
    assert len(by_node) == 8
    for node, kinds in by_node.items():
        assert kinds == [LOADING, LOADED, UNLOADED], node
    processes = [each for each in bag["/play_launch/states"] if each.kind == PROCESS]
    by_process: dict[str, list[str]] = {}
    for each in processes:
        by_process.setdefault(each.name, []).append(each.state)
    assert by_process == {
        name: [STARTED, READY, STOPPING, EXITED]
        for name in ("/chat", "/sensing/camera", "/monitor")
    }
    assert all(each.exit_code == 0 and each.signal == 0 for each in processes)
    lines = [each.msg for each in bag["/play_launch/output"]]
    assert any("I heard 'Hello from one process: 1'" in line for line in lines)
    reports = [line for line in lines if "by_pointer=" in line]
    assert reports
    for report in reports:
        counts = dict(part.split("=") for part in report.split() if "=" in part)
        assert counts["images"] == counts["by_pointer"], report
    with replay.bag.open("rb") as file:
        reader = make_reader(file)
        attachments = {each.name: each.data for each in reader.iter_attachments()}
        assert reader.get_header().profile == "ros2"
    assert attachments["config.yaml"] == DEMO.read_bytes()


def test_a_person_sees_plain_lines_and_the_name_of_the_recording(tmp_path: Path) -> None:
    with subprocess.Popen(
        [COMMAND, "replay", DEMO, "--log-dir", tmp_path], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        seen = ""
        for line in process.stdout:
            seen += line
            if "/slow_starter loaded" in line:
                process.send_signal(signal.SIGINT)
    assert process.returncode == 128 + signal.SIGINT, seen
    assert "\x1b" not in seen
    assert "/monitor" in seen
    assert "session.mcap" in seen.splitlines()[-1]
    assert (tmp_path / "latest" / "session.mcap").is_file()


FAILING = """
version: 1
duration: 3 s
containers:
  - name: mixed
    composable_nodes:
      - {package: play_launch_demo, plugin: play_launch_demo::Talker, name: talker}
      - {package: play_launch_demo, plugin: play_launch_demo::ThrowingConstructor, name: broken}
"""


def test_a_failed_node_is_told_with_its_reason_and_ends_in_exit_code_1(tmp_path: Path) -> None:
    config = write(tmp_path / "failing.yaml", FAILING)
    with replaying(config, tmp_path / "logs") as replay:
        failed = replay.read_until(
            lambda event: event["event"] == "component" and event["kind"] == "load_failed",
            "a load failure",
        )
        assert failed["full_node_name"] == "/broken"
        assert "no such camera" in failed["error_message"]
        replay.read_all()
    assert replay.process.returncode == 1
    kinds = Counter(each.event_type for each in read_bag(replay.bag)["/play_launch/events"])
    assert kinds[LOADED] == 1
    assert kinds[LOAD_FAILED] == 1


SLOW = """
version: 1
duration: 2 s
containers:
  - name: slow
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::SlowConstructor
        name: slow_starter
        parameters: {seconds: 600.0}
"""


def test_missing_nodes_end_in_exit_code_3(tmp_path: Path, ros_domain: int) -> None:
    config = write(tmp_path / "slow.yaml", SLOW)
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_all()
    assert replay.process.returncode == 3
    assert not ports_left_in(ros_domain)


RESTARTING_CONFIG = """
version: 1
composable_node_loading:
  restart: {max_restarts: 2, within: 60 s, backoff: {initial: 50 ms, maximum: 100 ms}}
containers:
  - name: victim
    composable_nodes:
      - {package: play_launch_demo, plugin: play_launch_demo::Talker, name: talker}
      - {package: play_launch_demo, plugin: play_launch_demo::Listener, name: listener}
  - name: bystander
    composable_nodes:
      - {package: play_launch_demo, plugin: play_launch_demo::Listener, name: witness}
"""


def is_process(name: str, kind: str) -> Any:
    return lambda event: (
        event["event"] == "process" and event["name"] == name and event["kind"] == kind
    )


def loaded_again(replay: Replay, nodes: set[str]) -> None:
    missing = set(nodes)

    def done(event: dict[str, Any]) -> bool:
        if event["event"] == "component" and event["kind"] == "loaded":
            missing.discard(event["full_node_name"])
        return not missing

    replay.read_until(done, f"{missing} loaded")


def test_a_dead_container_comes_back_with_its_nodes_within_bounds(tmp_path: Path) -> None:
    config = write(tmp_path / "restarting.yaml", RESTARTING_CONFIG)
    nodes = {"/talker", "/listener"}
    with replaying(config, tmp_path / "logs") as replay:
        loaded_again(replay, nodes | {"/witness"})
        bystander = next(
            event for event in replay.seen if is_process("/bystander", "started")(event)
        )
        dead = []
        for _ in range(2):
            pid = [e for e in replay.seen if is_process("/victim", "started")(e)][-1]["pid"]
            victim = psutil.Process(pid)
            victim.send_signal(signal.SIGSEGV)
            gone = replay.read_until(is_process("/victim", "exited"), "the death")
            assert (gone["pid"], gone["signal"]) == (pid, signal.SIGSEGV)
            dead.append(victim)
            replay.read_until(is_process("/victim", "started"), "the restart")
            loaded_again(replay, nodes)
        pid = [e for e in replay.seen if is_process("/victim", "started")(e)][-1]["pid"]
        os.kill(pid, signal.SIGKILL)
        given_up = replay.read_until(is_process("/victim", "gave_up"), "giving up")
        assert "2" in given_up["message"]
        assert not alive(dead)
        assert psutil.pid_exists(bystander["pid"])
        replay.process.send_signal(signal.SIGTERM)
        replay.read_all()
    assert replay.process.returncode == 128 + signal.SIGTERM
    kinds = Counter(
        each.state
        for each in read_bag(replay.bag)["/play_launch/states"]
        if each.kind == PROCESS and each.name == "/victim"
    )
    assert kinds[STARTED] == 3
    assert kinds[GAVE_UP] == 1


def test_nothing_outlives_a_supervisor_that_is_killed(tmp_path: Path, ros_domain: int) -> None:
    config = write(
        tmp_path / "orphans.yaml",
        RESTARTING_CONFIG
        + """
nodes:
  - name: sleeper
    command: [sleep, "600"]
""",
    )
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_until(is_process("/sleeper", "started"), "the sleeper")
        loaded_again(replay, {"/talker", "/listener", "/witness"})
        started = replay.descendants()
        assert len(started) >= 3
        os.kill(replay.pid, signal.SIGKILL)
        replay.process.wait()
        _, left = psutil.wait_procs(started, timeout=60)
        assert not left
    assert replay.process.returncode == -signal.SIGKILL
    cut = next((tmp_path / "logs").glob("*/session.mcap.active"))
    copy = tmp_path / "cut.mcap"
    copy.write_bytes(cut.read_bytes())
    assert copy.stat().st_size > 0
    # The containers leave by themselves and clean up; only what was killed may need the sweep.
    assert not ports_left_in(ros_domain)


def test_an_ordinary_executable_runs_beside_the_containers(tmp_path: Path) -> None:
    config = write(
        tmp_path / "nodes.yaml",
        """
version: 1
duration: 2 s
nodes:
  - name: hello
    command: [sh, -c, "echo out; echo err >&2; exec sleep 600"]
""",
    )
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_all()
    assert replay.process.returncode == 0
    lines = {(each.file, each.msg) for each in read_bag(replay.bag)["/play_launch/output"]}
    assert lines == {("stdout", "out"), ("stderr", "err")}


BROKEN = """
import sys
from play_launch.cli import entry
import play_launch.{module} as broken
def fail(*arguments, **options):
    raise OSError(24, "Too many open files")
broken.{function} = fail
entry.main()
"""


@pytest.mark.parametrize(
    ("module", "function", "what"),
    [
        ("postmortem.upkeep", "look_after_sessions", "care for earlier recordings"),
        ("control.serve", "package_version", "control by commands"),
    ],
)
def test_the_system_goes_on_without_what_fails_beside_it_and_reports_that(
    module: str, function: str, what: str, tmp_path: Path
) -> None:
    config = write(
        tmp_path / "robot.yaml",
        "{version: 1, record: {ros: false}, nodes: [{name: idle, command: [sleep, infinity]}]}",
    )
    program = (sys.executable, "-c", BROKEN.format(module=module, function=function))
    with replaying(config, tmp_path / "logs", program=program) as replay:
        reported = replay.read_until(lambda event: event["event"] == "log", "a report")
        assert (reported["level"], reported["name"]) == (40, "play_launch.cli.background")
        assert f"the system continues without {what}" in reported["message"]
        assert "Too many open files" in reported["message"]
        if module == "serve_control":
            folder = (tmp_path / "logs" / "latest").resolve()
            asking = [str(COMMAND), "ps", "--session", str(folder)]
            asked = subprocess.run(asking, check=False, capture_output=True, text=True)
            assert asked.returncode == 1
            assert "no session" in asked.stderr
        assert replay.process.poll() is None
        replay.process.send_signal(signal.SIGINT)
        assert replay.read_all()[-1]["exit_code"] == 128 + signal.SIGINT


@pytest.mark.parametrize("verb", ["replay", "check"])
def test_a_bad_configuration_starts_nothing(verb: str, tmp_path: Path) -> None:
    config = write(tmp_path / "bad.yaml", "version: 1\ncontainers:\n  - name: 3\n    nmae: x\n")
    arguments: list[str | Path] = ["--log-dir", tmp_path / "logs"] if verb == "replay" else []
    result = subprocess.run(
        [COMMAND, verb, config, *arguments], check=False, capture_output=True, text=True
    )
    assert result.returncode == 2
    assert f"{config}:3:" in result.stderr + result.stdout
    assert f"{config}:4:" in result.stderr + result.stdout
    assert not (tmp_path / "logs").exists()


def test_check_answers_machines_in_json() -> None:
    result = subprocess.run(
        [COMMAND, "check", DEMO, "--json"], check=False, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    answer = json.loads(result.stdout)
    assert answer["valid"] is True
