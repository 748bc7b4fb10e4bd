"""The benchmarks run: little of everything is enough to see that they measure."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from benchmarks.browser import find_browser
from benchmarks.intra_process import DDS, ISOLATED, STANDARD
from play_launch.postmortem.session import PastSession
from play_launch.postmortem.timeline import read_timeline
from play_launch.supervisor.outcome import Cause
from tests.support.mounts import mounted

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
    """What it wrote as JSON, with a picture beside it."""
    file, picture = folder / "figures.json", folder / "figures.svg"
    run(module, *arguments, "--json", file, "--plot", picture)
    assert ET.fromstring(picture.read_text(encoding="utf-8")).tag.endswith("svg")
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


def test_images(tmp_path: Path) -> None:
    names = [STANDARD, ISOLATED, DDS]
    arguments = ("--rounds", "2", "--images", "5", "--variants", ";".join(names))
    rows = stored(tmp_path, "intra_process", *arguments)
    assert list(rows) == names
    assert all(row["count"] == 10 and row["min"] > 0 for row in rows.values())


def test_changes_and_orphans() -> None:
    (parts,) = json.loads(run("apply", "--runs", "1", "--seconds", "0.5", "--json"))
    assert set(parts) == {"nothing", "four changes", "a parameter"}
    for part in parts.values():
        assert (part["missing"], part["began_anew"]) == (0, 0)
    mounted("true", "true")  # skips where the benchmark could not have its own /dev/shm
    (trial,) = json.loads(run("orphans", "--trials", "1", "--json"))
    assert trial["orphans"] == []


def test_recorded_topics_and_samples() -> None:
    name = "small at 1 kHz"
    figures = json.loads(run("recorder", "--seconds", "1", "--json", "--cases", name))[name]
    assert figures["messages/s"] > 0
    small = ("--containers", "1", "--nodes", "2", "--runs", "1", "--settle", "0.5")
    figures = json.loads(run("sampling", *small, "--seconds", "2", "--json"))
    assert all(len(figures[kind]) == 1 for kind in ("sampled", "not sampled"))


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
