"""Libraries that crash or take long while they are loaded, in containers of all types."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.replay import COMMAND, Replay, alive, recorded, replaying
from tests.support.scenes import container, node, written

TYPES = ("standard", "mt", "isolated", "isolated_mt")
WAYS = {"segv": signal.SIGSEGV, "abort": signal.SIGABRT, "throw": signal.SIGABRT, "exit": 0}
LOAD_FAILED = 2


def config(folder: Path, containers: dict[str, tuple[str, str]], **keys: Any) -> Path:
    bad = {"package": "play_launch_demo_crashing", "plugin": "play_launch_demo::CrashingLibrary"}
    found = [
        container(
            name,
            node(f"{name}_talker"),
            {**bad, "name": f"{name}_bad"},
            node(f"{name}_listener", "Listener"),
            container_type=kind,
            environment={"PLAY_LAUNCH_DEMO_CRASH": way},
        )
        for name, (kind, way) in containers.items()
    ]
    return written(folder, containers=found, **keys)


@pytest.fixture(scope="module")
def poisoned(tmp_path_factory: pytest.TempPathFactory) -> Replay:
    folder = tmp_path_factory.mktemp("poison")
    containers = {kind: (kind, "segv") for kind in TYPES}
    containers |= {way: ("standard", way) for way in WAYS if way != "segv"}
    states = {f"/{name}_bad": "load failed" for name in containers}
    states |= {
        f"/{name}_{node}": "loaded" for name in containers for node in ("talker", "listener")
    }
    with replaying(config(folder, containers), folder / "log") as replay:
        replay.read_until_states(states)
        replay.process.send_signal(signal.SIGINT)
        replay.read_all()
    return replay


@pytest.fixture(scope="module")
def for_a_person(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[str]]:
    """A run on a terminal that exits on its own."""
    folder = tmp_path_factory.mktemp("person")
    path = config(folder, {"c": ("isolated", "segv")}, duration="12 s")
    process = subprocess.Popen(
        [COMMAND, "replay", path, "--log-dir", folder / "log"], stdout=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=60)


@pytest.mark.parametrize("name", [*TYPES, "abort", "throw", "exit"])
def test_the_container_ends_once_at_most_and_comes_back_with_all_the_others(
    poisoned: Replay, name: str
) -> None:
    assert len(poisoned.told(name=f"/{name}", kind="started")) <= 2
    summary = next(each for each in poisoned.seen[-1]["containers"] if each["name"] == f"/{name}")
    assert (summary["state"], summary["loaded"]) == ("running", 2)
    assert summary["failed"] == [f"/{name}_bad"]


@pytest.mark.parametrize("name", [*TYPES, "abort", "throw", "exit"])
def test_the_node_fails_to_load_with_signal_library_and_backtrace(
    poisoned: Replay, name: str
) -> None:
    (failed,) = poisoned.told(full_node_name=f"/{name}_bad", kind="load_failed")
    assert failed["signal"] == WAYS.get(name, signal.SIGSEGV)
    assert "libplay_launch_demo_crashing.so" in failed["error_message"]
    if failed["signal"]:
        assert any("crash_while_opening" in frame for frame in failed["backtrace"])
    state = poisoned.told(event="node", node=f"/{name}_bad", state="load failed")[0]
    assert "libplay_launch_demo_crashing.so" in state["reason"]


def test_the_recording_has_it_all(poisoned: Replay) -> None:
    failed = {
        each.full_node_name: each
        for each in recorded(poisoned.bag, "/play_launch/events")
        if each.event_type == LOAD_FAILED
    }
    logs = [
        *recorded(poisoned.bag, "/play_launch/output"),
        *recorded(poisoned.bag, "/play_launch/log/all"),
        *recorded(poisoned.bag, "/rosout"),
    ]
    for kind in TYPES:
        event = failed[f"/{kind}_bad"]
        assert event.signal == signal.SIGSEGV
        assert "libplay_launch_demo_crashing.so" in event.error_message
        assert any("crash_while_opening" in frame for frame in event.backtrace)
        # What the container wrote before its own end: library, node and signal.
        last_words = next(
            log.msg for log in logs if log.name == f"/{kind}" and f"for node /{kind}_bad" in log.msg
        )
        assert "libplay_launch_demo_crashing.so" in last_words
        assert "SIGSEGV" in last_words


@pytest.mark.usefixtures("for_a_person")  # both mostly wait
def test_an_interrupt_ends_a_scratch_process_that_still_runs(tmp_path: Path) -> None:
    slow = {"package": "play_launch_demo_slow", "plugin": "play_launch_demo::SlowLibrary"}
    one = container("c", {**slow, "name": "a"}, environment={"PLAY_LAUNCH_DEMO_OPENING": "600"})
    with replaying(written(tmp_path, containers=[one]), tmp_path / "log") as replay:
        replay.until(event="node", state="loading")
        (started,) = replay.told(event="process", kind="started")
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


OPENING = 6.0
"""Seconds; twice as long as a container may leave the supervisor without an answer."""


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Replay:
    folder = tmp_path_factory.mktemp("slow")
    library = {"package": "play_launch_demo_slow", "plugin": "play_launch_demo::SlowLibrary"}
    containers = [
        container(
            kind,
            node(f"{kind}_talker"),
            {**library, "name": f"{kind}_slow"},
            {**library, "name": f"{kind}_slow_too"},
            container_type=kind,
            loading_timeout="2 s",
        )
        for kind in TYPES
    ]
    names = [f"/{kind}_{name}" for kind in TYPES for name in ("talker", "slow", "slow_too")]
    with replaying(written(folder, containers=containers), folder / "log") as replay:
        replay.read_until_states(dict.fromkeys(names, "loaded"))
    return replay


@pytest.mark.parametrize("kind", TYPES)
def test_no_container_is_taken_for_frozen(slow: Replay, kind: str) -> None:
    assert len(slow.told(name=f"/{kind}", kind="started")) == 1
    assert not slow.told(name=f"/{kind}", kind="exited")


@pytest.mark.parametrize("kind", TYPES)
def test_its_nodes_are_loaded_at_the_first_attempt(slow: Replay, kind: str) -> None:
    for name in ("slow", "slow_too"):
        (loading,) = slow.told(full_node_name=f"/{kind}_{name}", kind="loading")
        (loaded,) = slow.told(full_node_name=f"/{kind}_{name}", kind="loaded")
        assert (loaded["stamp_ns"] - loading["stamp_ns"]) * 1e-9 > OPENING / 2
    assert len(slow.told(full_node_name=f"/{kind}_talker", kind="loaded")) == 1


@pytest.mark.parametrize("kind", TYPES)
def test_it_is_reported_what_they_wait_for(slow: Replay, kind: str) -> None:
    reasons = [each["reason"] for each in slow.told(event="node", node=f"/{kind}_slow")]
    assert any("libplay_launch_demo_slow.so" in reason for reason in reasons), reasons
