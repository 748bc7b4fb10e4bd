"""Checks in environments, and under limits, other than this machine's."""

from __future__ import annotations

import errno
import os
import resource
from pathlib import Path

import pytest

from play_launch.doctor import machine, ros
from play_launch.doctor.check_result import CheckResult, Severity

OK, WARN, FAIL = Severity.OK, Severity.WARN, Severity.FAIL
CYCLONE, FASTDDS = "rmw_cyclonedds_cpp", "rmw_fastrtps_cpp"
NO_LIMIT = resource.RLIM_INFINITY


def is_(finding: CheckResult, level: Severity, words: str) -> None:
    assert finding.level is level
    assert words in f"{finding.says} | {finding.impact} | {finding.fix}"
    assert bool(finding.impact) is (level is not OK)
    assert finding.fix or level is OK


@pytest.mark.parametrize(
    ("given", "rmw", "level", "words"),
    [
        ({}, FASTDDS, OK, "SUBNET"),
        ({}, CYCLONE, WARN, "MaxAutoParticipantIndex"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, FASTDDS, WARN, "first 32"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, CYCLONE, WARN, "after 32 processes"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}, CYCLONE, OK, "SYSTEM_DEFAULT"),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "CYCLONEDDS_URI": "x"},
            CYCLONE,
            OK,
            "this machine only",
        ),
        ({"ROS_LOCALHOST_ONLY": "1"}, FASTDDS, WARN, "first 32"),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "subnet", "ROS_LOCALHOST_ONLY": "1"},
            FASTDDS,
            OK,
            "SUBNET",
        ),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, FASTDDS, WARN, "container_type stock"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "NEAR"}, FASTDDS, WARN, "does not know"),
    ],
)
def test_discovery(given: dict[str, str], rmw: str, level: Severity, words: str) -> None:
    is_(machine.discovery(given, rmw), level, words)


@pytest.mark.parametrize(
    ("given", "level", "words"),
    [
        ("", OK, "ports 7400"),
        ("233", FAIL, "0 to 232"),
        ("five", FAIL, "five"),
        ("-1", FAIL, "-1"),
        ("101", OK, "32650 to 32767"),
        ("102", WARN, "ephemeral"),
    ],
)
def test_domain(given: str, level: Severity, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "_text", lambda _: "32768\t60999\n")
    is_(machine.domain({"ROS_DOMAIN_ID": given}), level, words)


@pytest.mark.parametrize(
    ("check", "limits", "level", "words"),
    [
        ("address_space", (512 << 20, NO_LIMIT), FAIL, "512 MiB"),
        ("address_space", (2 << 30, NO_LIMIT), WARN, "2.0 GiB"),
        ("address_space", (8 << 30, NO_LIMIT), OK, "8.0 GiB"),
        ("open_files", (1024, 4096), OK, "replay raises its own to 4,096"),
        ("open_files", (1024, NO_LIMIT), OK, "raises its own to 65,536"),
        ("open_files", (1024, 2048), WARN, "1,024 (at most 2,048)"),
        ("open_files", (4096, 4096), OK, "4,096"),
        ("processes", (1024, 4096), WARN, "LimitNPROC=infinity"),
        ("processes", (NO_LIMIT, NO_LIMIT), OK, "unlimited"),
        ("core_dumps", (0, 0), OK, "backtrace"),
        ("core_dumps", (NO_LIMIT, NO_LIMIT), OK, "unlimited"),
        ("locked_memory", (8 << 20, NO_LIMIT), OK, "8 MiB"),
        ("real_time", (0, 0), OK, "fifo and rr are refused"),
        ("real_time", (40, 40), OK, "up to 40"),
        ("nice_values", (0, 0), OK, "docs/resources.md#rights"),
        ("nice_values", (25, 25), OK, "down to -5"),
    ],
)
def test_limits_of_a_user(
    check: str,
    limits: tuple[int, int],
    level: Severity,
    words: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: limits)
    monkeypatch.setattr(machine, "_has_capability", lambda _: False)
    monkeypatch.setattr(machine, "_text", lambda _: "")
    is_(getattr(machine, check)(), level, words)


def test_a_right_is_no_matter_of_limits_for_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (0, 0))
    monkeypatch.setattr(machine, "_has_capability", lambda _: True)
    is_(machine.real_time(), OK, "up to 99 (CAP_SYS_NICE)")
    is_(machine.nice_values(), OK, "down to -20")
    is_(machine.locked_memory(), OK, "unlimited")


@pytest.mark.parametrize(
    ("cpuinfo", "words"),
    [("flags : fpu", "no pku"), ("flags : fpu pku", "without ospke"), ("", "no pku")],
)
def test_protection_keys(cpuinfo: str, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "_text", lambda _: cpuinfo)
    is_(machine.protection_keys(), OK, words)


@pytest.mark.parametrize(
    ("largest", "words"),
    [
        ("212992\n", "up to 0.2 MiB |  | sysctl -w net.core.rmem_max=4194304"),
        ("4194304\n", "up to 4.0 MiB |  | "),
        ("", "rmem_max cannot be read"),
    ],
)
def test_receive_buffers(largest: str, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "_text", lambda _: largest)
    is_(machine.receive_buffers(), OK, words)


def test_a_kernel_without_pidfd(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_: int) -> int:
        raise OSError(errno.ENOSYS, "Function not implemented")

    monkeypatch.setattr(os, "pidfd_open", refused)
    is_(machine.kernel(), FAIL, "5.3 or newer")


def test_shared_memory_is_needed_by_fast_dds() -> None:
    (finding,) = machine.shared_memory(CYCLONE)
    is_(finding, OK, "rmw_cyclonedds_cpp is in use")
    assert [each.subject for each in machine.shared_memory(FASTDDS)] == [
        "shared memory",
        "leftovers",
    ]


def test_keys_of_ssh_that_machines_ignore(tmp_path: Path) -> None:
    config = tmp_path / "config"
    is_(machine.ssh_config(config), OK, "has no key")
    config.write_text("# the robot\nHost vision\n  HostName=10.0.0.2\n  ProxyJump gate\n")
    is_(machine.ssh_config(config), OK, "has no key")
    config.write_text("Host vision\n  ControlPath=~/.ssh/%h\n  stricthostkeychecking no\n")
    is_(machine.ssh_config(config), WARN, "has ControlPath, stricthostkeychecking")


def test_the_folder_for_recordings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLAY_LAUNCH_LOG_DIR", str(tmp_path / "to" / "come"))
    assert machine.recordings().level is not FAIL
    (tmp_path / "file").touch()
    monkeypatch.setenv("PLAY_LAUNCH_LOG_DIR", str(tmp_path / "file" / "below"))
    is_(machine.recordings(), FAIL, "PLAY_LAUNCH_LOG_DIR")


@pytest.mark.parametrize(
    ("version", "level", "words"),
    [
        ((3, 10, 4), FAIL, "3.11 or newer"),
        ((3, 13, 9), OK, "3.13.9"),
        ((3, 14, 0), WARN, "not tested"),
    ],
)
def test_python(version: tuple[int, ...], level: Severity, words: str) -> None:
    is_(ros.python(version), level, words)


def test_isolation() -> None:
    is_(ros.isolation("process", ("Linux is 5.10",)), WARN, "by process: Linux is 5.10")
    is_(ros.isolation("shared_memory", ("code is missing",)), OK, "by pointer; code is missing")
