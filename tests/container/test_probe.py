"""Trying a component's library out in a process of its own: `component_container --probe`."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from typing import Any

import pytest

from play_launch.container.environment import child_environment
from play_launch.container.ros import component_container, ros_installation

FAILED, USAGE = 1, 64


def probe(*arguments: str, **environment: str) -> tuple[int, str]:
    environ = child_environment(os.environ, ros_installation()) | environment
    done = subprocess.run(
        [component_container(), "--probe", *arguments],
        env=environ,
        stdout=subprocess.PIPE,
        text=True,
        check=False,
        timeout=60,
    )
    return done.returncode, done.stdout


def finding(name: str, **environment: str) -> tuple[int, dict[str, Any]]:
    plugin = f"play_launch_demo::{name.capitalize()}Library"
    status, line = probe(f"play_launch_demo_{name}", plugin, **environment)
    found = json.loads(line)
    assert found.keys() == {"library", "error", "signal", "modules", "backtrace"}
    assert found["library"].endswith(f"/lib/libplay_launch_demo_{name}.so")
    return status, found


def test_a_library_that_can_be_opened() -> None:
    status, found = finding("pool")
    assert (status, found["error"], found["signal"], found["backtrace"]) == (0, "", 0, [])


@pytest.mark.parametrize(
    ("crash", "number", "reason"),
    [
        ("segv", signal.SIGSEGV, "SIGSEGV (no memory at address 0x8)"),
        ("abort", signal.SIGABRT, "SIGABRT (abort() was called)"),
        ("throw", signal.SIGABRT, "uncaught exception std::runtime_error: no licence found"),
    ],
)
def test_an_initialiser_that_dies(crash: str, number: int, reason: str) -> None:
    status, found = finding("crashing", PLAY_LAUNCH_DEMO_CRASH=crash)
    assert (status, found["signal"]) == (FAILED, number)
    assert found["library"] in found["error"]
    assert reason in found["error"]
    assert any("play_launch_demo::crash_while_opening()" in line for line in found["backtrace"])
    assert any(line.endswith(f" {found['library']}") for line in found["modules"])


def test_an_initialiser_that_exits() -> None:
    status, found = finding("crashing", PLAY_LAUNCH_DEMO_CRASH="exit")
    assert (status, found["signal"], found["backtrace"]) == (FAILED, 0, [])
    assert "exit status 3 (exit() was called)" in found["error"]


@pytest.mark.parametrize(
    ("package", "plugin", "error"),
    [
        ("play_launch_nowhere", "x::Y", "package 'play_launch_nowhere' has no components"),
        ("play_launch_demo", "x::Y", "has no component 'x::Y'"),
        ("play_launch_broken", "play_launch_broken::MissingSymbol", "undefined symbol"),
        ("play_launch_broken", "play_launch_broken::MissingLibrary", "cannot open shared object"),
    ],
)
def test_what_cannot_be_found_or_opened(package: str, plugin: str, error: str) -> None:
    status, line = probe(package, plugin)
    found = json.loads(line)
    assert (status, found["signal"]) == (FAILED, 0)
    assert error in found["error"]


def test_both_names_are_needed() -> None:
    assert probe("play_launch_demo") == (USAGE, "")


def test_a_library_that_is_linked_against_a_python_half() -> None:
    status, line = probe("play_launch_demo", "play_launch_demo::Overlinked")
    assert (status, json.loads(line)["error"]) == (0, "")
