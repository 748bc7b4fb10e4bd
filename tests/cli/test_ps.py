"""The table of ``play-launch ps``."""

from __future__ import annotations

from typing import Any

from play_launch.cli.ps import table

ROW: dict[str, Any] = {
    "name": "/a",
    "kind": "process",
    "container": None,
    "state": "running",
    "reason": "",
    "managed": None,
    "pid": 7,
    "restarts": 0,
    "uptime_s": 3,
    "cpu_percent": None,
    "memory_bytes": None,
}
WAITING = {**ROW, "state": "waiting", "reason": "waits for the file flag, which does not come"}


def test_without_details_there_is_no_column_of_them() -> None:
    assert table([ROW]).splitlines() == [
        "NAME  KIND     STATE    PID  UPTIME  RESTARTS  CPU  MEMORY",
        "/a    process  running    7   3.0 s         0    -       -",
    ]


def test_why_something_is_as_it_is_comes_last() -> None:
    failed = {**ROW, "managed": {"state": "failed", "reason": "its transition configure failed"}}
    active = {**ROW, "managed": {"state": "active", "reason": ""}, "reason": "blocked"}
    title, *lines = table([ROW, WAITING, failed, active]).splitlines()
    at = title.index("DETAILS")
    assert [line[at:] for line in lines] == [
        "",
        WAITING["reason"],
        "autostart failed: its transition configure failed",
        "active; blocked",
    ]


def test_details_end_where_the_terminal_ends() -> None:
    assert max(map(len, table([WAITING], 90).splitlines())) == 90
    assert table([WAITING], 90).endswith("...\n")
    assert table([WAITING], 40).endswith("  waits for the fil...\n")
    assert table([WAITING], 200) == table([WAITING])
