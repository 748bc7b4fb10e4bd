"""The benchmarks run: little of everything is enough to see that they measure."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmarks.browser import find_browser
from play_launch.deploy.machines.namespaces import missing
from play_launch.postmortem.past_session import PastSession
from play_launch.postmortem.timeline import read_timeline
from play_launch.supervisor.outcome import Cause

ROOT = Path(__file__).parents[2]


def run(module: str, *arguments: str | Path) -> str:
    """What it printed."""
    result = subprocess.run(
        [sys.executable, "-m", f"benchmarks.{module}", *arguments],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def stored(folder: Path, module: str, *arguments: str) -> Any:
    """What it wrote as JSON."""
    file = folder / "figures.json"
    assert "(goal: " in run(module, *arguments, "--json", file)
    return json.loads(file.read_text(encoding="utf-8"))["rows"]


def test_crashes(tmp_path: Path) -> None:
    kinds = "segv/callback,exception/constructor"
    arguments = ("--count", "3", "--modes", "isolated", "--kinds", kinds)
    nowhere, *rows = stored(tmp_path, "crash", *arguments, "--unquiesced", "segv/callback")
    assert nowhere["kind"] == "none/nowhere"
    assert {row["kind"] for row in rows} == set(kinds.split(","))
    assert [row["quiesced"] for row in rows].count(False) == 1
    for row in rows:
        assert row["event_ms"]["count"] == row["crashes"] >= row["wanted"], row
        assert not row["quiesced"] or (row["complete"] and row["missed"] == 0), row


def test_the_page_of_a_long_session(tmp_path: Path) -> None:
    printed = run("report", "--runs", "1", "--nodes", "12", "--hours", "0.02")
    # Without a browser the rest is measured all the same.
    assert ("in the browser: whole" in printed) == (find_browser() is not None)
    bag = tmp_path / "session.mcap"
    run("long_session", bag, "--nodes", "12", "--hours", "0.02", "--lines", "100")
    session = PastSession(bag)
    events = [recorded.event for recorded in session.events()]
    stamps = [event.stamp_ns for event in events]
    assert stamps == sorted(stamps)
    causes = {getattr(event, "cause", Cause.NONE) for event in events}
    assert Cause.NOT_RECORDED not in causes
    assert (session.reader.is_complete, session.reader.damages) == (True, [])
    assert read_timeline(bag).size()["node"] == 12


@pytest.mark.parametrize("option", ["--kinds", "--modes"])
def test_what_does_not_exist_is_refused(option: str) -> None:
    command = [sys.executable, "-m", "benchmarks.crash", option, "boredom"]
    result = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    assert result.returncode != 0


@pytest.mark.skipif(bool(missing()), reason=missing())
def test_several_machines_lose_no_line_and_no_event() -> None:
    found = json.loads(run("machines", "--runs=1", "--cuts=1", "--containers=1", "--json"))
    for key in ("ticks", "starts"):
        arrived, wrong = found[key]
        assert arrived > 10
        assert wrong == 0


def test_a_system_at_rest_is_sampled() -> None:
    system = ("--runs=1", "--seconds=1", "--settle=0", "--containers=1", "--nodes=2")
    found = json.loads(run("sampling", *system, "--json"))
    assert {"sampled", "not sampled"} <= found.keys()
    assert all(len(runs) == 1 for runs in found.values())


def test_measured_topics_are_as_expected() -> None:
    found = json.loads(run("expectations", "--topics=2", "--rate=20", "--seconds=1", "--json"))
    assert (found["with"]["met"], found["without"]["met"]) == (2, 0)


@pytest.mark.skipif(find_browser() is None, reason="no Chromium")
def test_a_crash_is_on_the_page() -> None:
    found = json.loads(run("web", "--crashes=2", "--seconds=1", "--viewers", "0", "1", "--json"))
    assert len(found["crash_to_page"]) == 2
    assert set(found["cpu"]) == {"0", "1"}
