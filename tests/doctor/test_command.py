"""The real command on this machine, and the table that it prints."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import psutil
import pytest

from play_launch.cli.doctor import examine, lines
from play_launch.doctor.check_result import Severity, fail, ok, warn
from tests.support.replay import run


def doctor(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return run("doctor", *arguments, env={**os.environ, **variables})


def findings(result: subprocess.CompletedProcess[str]) -> dict[str, dict[str, Any]]:
    return {each["subject"]: each for each in json.loads(result.stdout)["findings"]}


def test_this_machine_can_run_what_the_other_tests_run() -> None:
    result = doctor("--json")
    assert result.returncode == 0, result.stdout + result.stderr
    assert json.loads(result.stdout)["can_run"] is True
    found = findings(result)
    assert found["container"]["level"] == "ok"
    assert found["ROS"]["level"] == "ok"
    assert found["isolation"]["says"].startswith("by ")
    assert found["domain"]["says"].startswith(os.environ["ROS_DOMAIN_ID"])
    children = psutil.Process().children(recursive=True)
    assert not [child for child in children if "component_container" in " ".join(child.cmdline())]


def test_what_keeps_a_system_from_running_is_said_by_exit_code_and_result() -> None:
    result = doctor("--json", ROS_DOMAIN_ID="999")
    assert result.returncode == 1
    assert json.loads(result.stdout)["can_run"] is False
    levels = {subject: each["level"] for subject, each in findings(result).items()}
    assert [subject for subject, level in levels.items() if level == "fail"] == ["domain"]
    assert "No system can be started here" in doctor(ROS_DOMAIN_ID="999").stdout


def test_two_installations_of_ros_are_seen(tmp_path: Path) -> None:
    marker = tmp_path / "share" / "rcl" / "package.xml"
    marker.parent.mkdir(parents=True)
    marker.touch()
    result = doctor("--json", AMENT_PREFIX_PATH=str(tmp_path))
    found = findings(result)
    if found["ROS"]["level"] == "ok":
        pytest.skip("ROS does not come from wheels here, so that there is one installation only")
    assert result.returncode == 1
    assert "installed twice" in found["ROS"]["says"]


def test_a_middleware_that_is_not_there_is_named_and_the_rest_still_checked() -> None:
    result = doctor("--json", RMW_IMPLEMENTATION="rmw_of_nobody")
    found = findings(result)
    assert result.returncode == 1
    assert found["middleware"]["level"] == "fail"
    assert "rmw_of_nobody" in found["middleware"]["says"]
    assert found["container"]["level"] == "ok"


def test_a_rclpy_that_does_not_load_is_diagnosed(tmp_path: Path) -> None:
    module = tmp_path / "rclpy" / "__init__.py"
    module.parent.mkdir()
    module.write_text("raise ImportError('made for another Python')", encoding="utf-8")
    result = doctor("--json", PYTHONPATH=str(tmp_path))
    assert result.returncode == 1
    assert result.stderr == ""
    found = findings(result)
    assert found["rclpy"]["level"] == "fail"
    assert "made for another Python" in found["rclpy"]["says"]
    assert found["container"]["level"] == "ok"


def test_a_container_that_does_not_start_is_quoted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LD_PRELOAD", "/not/there.so")
    monkeypatch.setattr("play_launch.doctor.ros.component_container", lambda: Path("/bin/false"))
    container = next(each for each in examine() if each.subject == "container")
    assert container.level is Severity.FAIL
    assert "/bin/false: " in container.says
    assert "/not/there.so" in container.says


def test_the_table_has_a_line_for_each_and_its_fix() -> None:
    report = [ok("a", "fine"), warn("b", "so so", "time", "wait"), fail("c", "bad", "all", "mend")]
    assert list(lines(report, colour=False)) == [
        "ok    a  fine",
        "warn  b  so so",
        "         impact: time",
        "         fix: wait",
        "fail  c  bad",
        "         impact: all",
        "         fix: mend",
        "",
        "No system can be started here: c.",
    ]


def test_the_result_counts_what_is_lost() -> None:
    for count, words in ((0, "no warnings."), (1, "1 warning."), (2, "2 warnings.")):
        report = [ok("a", "fine"), *[warn("b", "so so", "time", "wait")] * count]
        assert [*lines(report, colour=False)][-1].endswith(words)
