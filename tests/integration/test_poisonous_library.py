"""A library that crashes while it is loaded, in containers of all types of the real command."""

from __future__ import annotations

import os
import signal
import subprocess
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from tests.support.replay import COMMAND, Replay, alive, replaying

TYPES = ("standard", "mt", "isolated", "isolated_mt")
WAYS = {"segv": signal.SIGSEGV, "abort": signal.SIGABRT, "throw": signal.SIGABRT, "exit": 0}
LOAD_FAILED = 2

CONTAINER = """\
  - name: {name}
    container_type: {kind}
    environment: {{PLAY_LAUNCH_DEMO_CRASH: {way}}}
    composable_nodes:
      - package: play_launch_demo
        plugin: play_launch_demo::Talker
        name: {name}_talker
      - package: play_launch_demo_crashing
        plugin: play_launch_demo::CrashingLibrary
        name: {name}_bad
      - package: play_launch_demo
        plugin: play_launch_demo::Listener
        name: {name}_listener
"""

SLOW = """\
version: 1
containers:
  - name: c
    environment: {PLAY_LAUNCH_DEMO_OPENING: '600'}
    composable_nodes:
      - package: play_launch_demo_slow
        plugin: play_launch_demo::SlowLibrary
        name: a
"""


def config(folder: Path, head: str, containers: dict[str, tuple[str, str]]) -> Path:
    text = "".join(
        CONTAINER.format(name=name, kind=kind, way=way) for name, (kind, way) in containers.items()
    )
    path = folder / "poison.yaml"
    path.write_text(f"version: 1\n{head}containers:\n{text}", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def poisoned(tmp_path_factory: pytest.TempPathFactory) -> Replay:
    folder = tmp_path_factory.mktemp("poison")
    containers = {kind: (kind, "segv") for kind in TYPES}
    containers |= {way: ("standard", way) for way in WAYS if way != "segv"}
    states = {f"/{name}_bad": "load failed" for name in containers}
    states |= {
        f"/{name}_{node}": "loaded" for name in containers for node in ("talker", "listener")
    }
    with replaying(config(folder, "", containers), folder / "log") as replay:
        replay.read_until_states(states)
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()
    return replay


@pytest.fixture(scope="module")
def for_a_person(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[str]]:
    """A run that is shown to a person and ends by itself."""
    folder = tmp_path_factory.mktemp("person")
    path = config(folder, "duration: 12 s\n", {"c": ("isolated", "segv")})
    process = subprocess.Popen(
        [COMMAND, "replay", path, "--log-dir", folder / "log"], stdout=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=60)


def components(replay: Replay, node: str, kind: str) -> list[dict[str, Any]]:
    return [
        event
        for event in replay.seen
        if (event["event"], event.get("kind")) == ("component", kind)
        and event["full_node_name"] == node
    ]


@pytest.mark.parametrize("name", [*TYPES, "abort", "throw", "exit"])
def test_the_container_ends_once_at_most_and_comes_back_with_all_the_others(
    poisoned: Replay, name: str
) -> None:
    starts = [
        event
        for event in poisoned.seen
        if event["event"] == "process" and (event["name"], event["kind"]) == (f"/{name}", "started")
    ]
    assert len(starts) <= 2
    summary = next(each for each in poisoned.seen[-1]["containers"] if each["name"] == f"/{name}")
    assert (summary["state"], summary["loaded"]) == ("running", 2)
    assert summary["failed"] == [f"/{name}_bad"]


@pytest.mark.parametrize("name", [*TYPES, "abort", "throw", "exit"])
def test_the_node_fails_to_load_with_signal_library_and_backtrace(
    poisoned: Replay, name: str
) -> None:
    (failed,) = components(poisoned, f"/{name}_bad", "load_failed")
    assert failed["signal"] == WAYS.get(name, signal.SIGSEGV)
    assert "libplay_launch_demo_crashing.so" in failed["error_message"]
    if failed["signal"]:
        assert any("crash_while_opening" in frame for frame in failed["backtrace"])
    state = next(
        event
        for event in poisoned.seen
        if event["event"] == "node"
        and (event["node"], event["state"]) == (f"/{name}_bad", "load failed")
    )
    assert "libplay_launch_demo_crashing.so" in state["reason"]


def test_the_recording_has_it_all(poisoned: Replay) -> None:
    found: dict[str, list[Any]] = defaultdict(list)
    with AnyReader([poisoned.bag]) as reader:
        for connection, _, raw in reader.messages():
            found[connection.msgtype].append(reader.deserialize(raw, connection.msgtype))
    failed = {
        each.full_node_name: each
        for each in found["play_launch_msgs/msg/ComponentEvent"]
        if each.event_type == LOAD_FAILED
    }
    for kind in TYPES:
        event = failed[f"/{kind}_bad"]
        assert event.signal == signal.SIGSEGV
        assert "libplay_launch_demo_crashing.so" in event.error_message
        assert any("crash_while_opening" in frame for frame in event.backtrace)
        # What the container wrote before its own end: library, node and signal.
        last_words = next(
            log.msg
            for log in found["rcl_interfaces/msg/Log"]
            if log.name == f"/{kind}" and f"for node /{kind}_bad" in log.msg
        )
        assert "libplay_launch_demo_crashing.so" in last_words
        assert "SIGSEGV" in last_words


@pytest.mark.usefixtures("for_a_person")  # both mostly wait
def test_an_interrupt_ends_a_scratch_process_that_still_runs(tmp_path: Path) -> None:
    path = tmp_path / "slow.yaml"
    path.write_text(SLOW, encoding="utf-8")
    with replaying(path, tmp_path / "log") as replay:
        replay.read_until(
            lambda event: event["event"] == "node" and event["state"] == "loading", "a load"
        )
        started = next(
            event
            for event in replay.seen
            if event["event"] == "process" and event["kind"] == "started"
        )
        os.kill(started["pid"], signal.SIGKILL)
        replay.read_until(
            lambda event: event["event"] == "node" and "scratch process" in event["reason"],
            "a probe",
        )
        replay.read_until(
            lambda event: event["event"] == "log" and "in a scratch process" in event["message"],
            "a report of the probe",
        )
        probing = [each for each in replay.descendants() if "--probe" in each.cmdline()]
        assert probing
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()
        assert replay.process.returncode == 128 + signal.SIGINT
        assert not alive(probing)


def test_a_person_reads_why_and_the_exit_code_is_that_of_a_failed_load(
    for_a_person: subprocess.Popen[str],
) -> None:
    output, _ = for_a_person.communicate(timeout=120)
    assert for_a_person.returncode == 1
    line = next(each for each in output.splitlines() if "/c_bad failed to load" in each)
    for word in ("libplay_launch_demo_crashing.so", "SIGSEGV", "crash_while_opening"):
        assert word in line
