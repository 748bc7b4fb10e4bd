"""The benchmark of the page measures, on a session that is small."""

from __future__ import annotations

from pathlib import Path

from benchmarks.browser import find_browser
from tests.benchmarks.test_commands import run


def test_the_page_is_measured() -> None:
    printed = run("report", "--runs", "1", "--nodes", "12", "--hours", "0.02")
    assert "12 nodes, 0.02 h, " in printed
    assert "play-launch report" in printed
    # Without a browser the rest is measured all the same.
    assert ("in the browser: whole" in printed) == (find_browser() is not None)
    assert "**short**" not in printed.splitlines()[-1]


def test_a_long_session_is_written(tmp_path: Path) -> None:
    bag = tmp_path / "session.mcap"
    printed = run("long_session", bag, "--nodes", "12", "--hours", "0.02", "--lines", "100")
    assert printed.startswith(f"{bag}: ")
    assert bag.is_file()
