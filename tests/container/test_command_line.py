"""The program's own options: version, failpoints, and the probe of a component's library."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
from play_launch_msgs.msg import ComponentEvent

from play_launch.container.environment import child_environment
from play_launch.container.ros import component_container, ros_installation
from tests.support.control_peer import StartContainer
from tests.support.isolated import survives
from tests.support.replay import finished

FAILED, USAGE = 1, 64


def program(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    environ = child_environment(os.environ, ros_installation()) | environment
    return finished([component_container(), *arguments], env=environ)


def probe(*arguments: str, **environment: str) -> tuple[int, str]:
    done = program("--probe", *arguments, **environment)
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
        ("play_launch_nowhere", "x::Y", "package 'play_launch_nowhere' is not installed"),
        ("play_launch_demo", "x::Y", "has no component 'x::Y'"),
        ("std_msgs", "x::Y", "registers no components"),
        ("play_launch_broken", "play_launch_broken::MissingSymbol", "undefined symbol"),
        ("play_launch_broken", "play_launch_broken::MissingLibrary", "cannot open shared object"),
    ],
)
def test_what_cannot_be_found_or_opened(package: str, plugin: str, error: str) -> None:
    status, line = probe(package, plugin)
    found = json.loads(line)
    assert (status, found["signal"]) == (FAILED, 0)
    assert error in found["error"]


def test_components_that_are_made_for_rclcpp(tmp_path: Path) -> None:
    index = tmp_path / "share/ament_index/resource_index/rclcpp_components"
    index.mkdir(parents=True)
    (index / "theirs").write_text("theirs::Node;lib/libtheirs.so\n", encoding="utf-8")
    status, line = probe("theirs", "theirs::Node", AMENT_PREFIX_PATH=str(tmp_path))
    has_rclcpp = "native rclcpp" in program("--version").stdout
    expected = "cannot load library" if has_rclcpp else "are made for rclcpp, which this container"
    assert (status, expected in json.loads(line)["error"]) == (FAILED, True), line


def test_both_names_are_needed() -> None:
    assert probe("play_launch_demo") == (USAGE, "")


def test_a_library_that_is_linked_against_a_python_half() -> None:
    status, line = probe("play_launch_demo", "play_launch_demo::Overlinked")
    assert (status, json.loads(line)["error"]) == (0, "")


def test_version_and_kinds_of_components() -> None:
    done = program("--version")
    version = r"component_container \d+\.\d+\.\d+, components: native( rclcpp)?\n"
    assert re.fullmatch(version, done.stdout)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("option", "value", "why"),
    [
        ("--fast", None, "unknown argument '--fast'"),
        ("--thread_num", None, "needs a value"),
        ("--thread_num", "many", "expected a number from 0 to "),
        ("--thread_num", "-1", "expected a number from 0 to "),
        ("--stop_timeout", "soon", "expected seconds from 0 to 3600"),
        ("--stop_timeout", "nan", "expected seconds from 0 to 3600"),
        ("--stop_timeout", "3601", "expected seconds from 0 to 3600"),
        ("--isolation", "partly", "expected auto, shared_memory or process"),
        ("--memory_domains", "on", "expected off, auto or required"),
        ("--resource", "colour 5", "expected a setting such as 'nice 5'"),
        ("--resource", "nice", "expected a setting such as 'nice 5'"),
        ("--resource", "nice five", "expected a setting such as 'nice 5'"),
        ("--resource", "nice 5 6", "expected a setting such as 'nice 5'"),
        ("--resource", "rlimit 7 1", "expected a setting such as 'nice 5'"),
        ("--resource", "cpu_affinity", "expected a setting such as 'nice 5'"),
        ("--resource", "cpu_affinity 9999", "expected a setting such as 'nice 5'"),
        ("--resource", "required_cgroup here", "expected a setting such as 'nice 5'"),
        ("--failpoints", "container.after_accept", "expected name=action"),
        ("--failpoints", "container.nowhere=abort", "there is no failpoint of that name"),
        ("--failpoints", "container.after_accept=explode", "the action is not one of hang, "),
        ("--failpoints", "container.after_accept=exit", "the action is not one of hang, "),
        ("--failpoints", "container.after_accept=once:2", "the action is not one of hang, "),
        ("--failpoints", "container.after_accept=exit:now", "the argument is no number"),
        ("--failpoints", "container.drop_event=born", "the type is not one of loading, "),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_line(
    option: str, value: str | None, why: str
) -> None:
    done = program(option, *filter(None, [value]))
    assert (done.returncode, done.stdout) == (USAGE, "")
    (line,) = done.stderr.splitlines()
    for word in (option, value or "", why):
        assert word in line


def test_several_failpoints_may_be_armed(spawn: StartContainer) -> None:
    container = spawn(failpoints="container.drop_event=loading;container.before_construct=exit:7")
    container.load("Talker")
    assert container.wait() == 7
    assert not any(isinstance(each, ComponentEvent) for each in container.seen)


def test_the_environment_arms_none(spawn: StartContainer) -> None:
    container = spawn(environment={"PLAY_LAUNCH_FAILPOINTS": "container.after_accept=abort"})
    with survives(container):
        container.loaded("Talker")
