"""The table of ``play-launch ps``."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from play_launch.cli.ps import lines
from play_launch.control.registration import LINKS
from tests.support.replay import finished

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

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
    assert lines([ROW]) == [
        "NAME  KIND     STATE    PID  UPTIME  RESTARTS  CPU  MEMORY",
        "/a    process  running    7   3.0 s         0    -       -",
    ]


def test_why_something_is_as_it_is_comes_last() -> None:
    failed = {**ROW, "managed": {"state": "failed", "reason": "its transition configure failed"}}
    active = {**ROW, "managed": {"state": "active", "reason": ""}, "reason": "blocked"}
    title, *shown = lines([ROW, WAITING, failed, active])
    at = title.index("DETAILS")
    assert [line[at:] for line in shown] == [
        "",
        WAITING["reason"],
        "autostart failed: its transition configure failed",
        "active; blocked",
    ]


def test_details_end_where_the_terminal_ends() -> None:
    assert max(map(len, lines([WAITING], 90))) == 90
    assert lines([WAITING], 90)[-1].endswith("...")
    assert lines([WAITING], 40)[-1].endswith("  waits for the fil...")
    assert lines([WAITING], 200) == lines([WAITING])


def test_ps_imports_next_to_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LINKS, str(tmp_path / "links"))
    program = [sys.executable, "-X", "importtime", "-c"]
    done = finished([*program, "from play_launch.cli.entry import main; main()", "ps", "--json"])
    assert "no session of yours is running" in done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("import time:")]
    imported = {line.rpartition("|")[2].strip() for line in lines}
    assert "typer" in imported
    assert not imported & {"rich", "asyncio", "msgspec", "pydantic", "yaml", "rclpy"}
