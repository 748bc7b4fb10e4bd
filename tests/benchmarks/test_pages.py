"""Figures on their way to the page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.crash.cases import QUIET, Case, Kind
from benchmarks.crash.goals import goals
from benchmarks.crash.report import result, table
from benchmarks.crash.tally import Tally
from benchmarks.graph_daemon import report as graph_daemon
from benchmarks.graph_daemon.daemons import OURS, STOCK
from benchmarks.publish import PAGE, PageError, publish, put
from benchmarks.range_chart import Bar, Lane, range_chart

positive = st.floats(1e-5, 1e7)
WELL: dict[str, float | None] = {
    "burst of 32, p99": 0.01,
    "burst of 32, failed": 0.0,
    "32 clients, p99": 0.01,
    "32 clients, failed": 0.0,
    "storm, p99 of bursts of 16": 0.1,
    "storm, failed": 0.0,
    "storm, nodes seen late": 0.0,
    "one client, median": 0.0001,
    "8 clients, calls per second": 8000.0,
    "late join, all nodes after": 1.0,
    "beside a silent client, longest": 0.001,
    "address change, too few for": 0.0,
    "after stop, stock start": 0.5,
    "node list": 0.05,
}
"""Ours, on a good day."""
BADLY: dict[str, float | None] = {
    "burst of 32, p99": 1.0,
    "storm, p99 of bursts of 16": 1.0,
    "storm, nodes seen late": 5.0,
    "one client, median": 0.001,
    "8 clients, calls per second": 1000.0,
    "late join, all nodes after": 2.0,
    "beside a silent client, longest": None,
    "node list": 0.3,
}
MACHINE = {"cpus": 2, "kernel": "6.1", "architecture": "x86_64", "allocator": "lib.so"}


def row(kind: Kind, tally: Tally) -> Any:
    return result(Case("isolated", kind, 10), tally, [], seconds=1.0, complete=True)


def well(kind: Kind) -> Any:
    times = [0.5] * 10
    return row(kind, Tally(crashes=10, event_ms=times, loaded_ms=times, gap_ms=times, recovered=0))


@given(st.lists(st.tuples(positive, positive).map(sorted), min_size=1, max_size=9))
def test_a_chart_shows_every_range_inside_of_the_picture(ranges: list[list[float]]) -> None:
    bars = [Bar(f"<{i}>", [Lane("a & b", (low, high))]) for i, (low, high) in enumerate(ranges)]
    root = ET.fromstring(range_chart("title", "ms", bars))
    drawn = [each for each in root.iter() if each.get("class") == "range"]
    assert len(drawn) == len(bars) + 1  # one in the legend
    for line in drawn:
        left, right = float(line.attrib["x1"]), float(line.attrib["x2"])
        assert 0 <= left <= right <= float(root.attrib["width"])
    assert "<0>" in [each.text for each in root.iter()]


def test_a_chart_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="nothing was measured"):
        range_chart("title", "ms", [Bar("a", [Lane("b", None)])])


def test_what_is_well_reaches_every_goal() -> None:
    kinds = [Kind("segv", "callback"), Kind("kill", "outside"), Kind("segv", "outside")]
    found = goals([well(QUIET), *map(well, kinds)])
    assert len(found) == 10  # all but the time to find poisoned containers: there were none
    assert all(goal.met for goal in found)


@pytest.mark.parametrize(
    ("kind", "tally", "what"),
    [
        (Kind("segv", "callback"), Tally(crashes=10, restarts=1), "cost a container"),
        (Kind("kill", "outside"), Tally(crashes=10, restarts=1), "SIGKILL"),
        (Kind("segv", "outside"), Tally(crashes=10, restarts=1), "SIGSEGV"),
        (Kind("abrt", "thread"), Tally(crashes=10, undetected=1), "person"),
        (Kind("abrt", "thread"), Tally(crashes=10, missed=1), "not reported"),
        (Kind("abrt", "thread"), Tally(crashes=10, collateral=1), "neighbours"),
        (Kind("abrt", "thread"), Tally(crashes=10, gap_ms=[1.0, 11.1]), "gap"),
        (Kind("abrt", "thread"), Tally(crashes=10, detection_s=[5.1]), "found"),
        (Kind("abrt", "thread"), Tally(crashes=10, loaded_ms=[20.0]), "loaded"),
        (Kind("abrt", "thread"), Tally(crashes=10, event_ms=[0.5, 5.0]), "p99"),
    ],
)
def test_what_is_short_is_said(kind: Kind, tally: Tally, what: str) -> None:
    (short,) = (goal for goal in goals([row(kind, tally)]) if not goal.met)
    assert what in short.what


def test_a_daemon_that_is_well_reaches_every_goal() -> None:
    subjects = graph_daemon.from_json({OURS.name: WELL, STOCK.name: BADLY})
    assert graph_daemon.to_json(subjects) == {OURS.name: WELL, STOCK.name: BADLY}
    found = graph_daemon.goals(subjects)
    assert len(found) == 13
    assert all(goal.met for goal in found)
    assert len(graph_daemon.goals({OURS.name: subjects[OURS.name]})) == 6


@pytest.mark.parametrize(
    ("row", "value"),
    [
        ("burst of 32, p99", 0.06),
        ("8 clients, calls per second", 3900.0),
        ("late join, all nodes after", None),
        ("storm, nodes seen late", 2.0),
        ("storm, failed", 1.0),
        ("beside a silent client, longest", 0.1),
        ("address change, too few for", 0.1),
        ("after stop, stock start", None),
    ],
)
def test_what_a_daemon_misses_is_said(row: str, value: float | None) -> None:
    subjects = graph_daemon.from_json({OURS.name: {**WELL, row: value}, STOCK.name: BADLY})
    (short,) = (goal for goal in graph_daemon.goals(subjects) if not goal.met)
    assert short.what == row


def test_what_went_wrong_stands_below_its_row() -> None:
    tally = Tally(crashes=10, undetected=2, collateral=1)
    text = table([row(Kind("segv", "callback"), tally)])
    assert "! 2 times the supervisor did not notice" in text
    assert "! 1 neighbours died" in text


def test_the_page_keeps_all_but_the_figures(tmp_path: Path) -> None:
    page = tmp_path / "benchmarks.md"
    page.write_text(PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    crash = {"benchmark": "crash", "machine": MACHINE, "rows": [well(Kind("segv", "callback"))]}
    figures = {"count": 3, "min": 1.0, "p50": 2.0, "p99": 3.0, "max": 4.0}
    images = {
        "benchmark": "intra_process",
        "machine": MACHINE,
        "rate": 30.0,
        "rounds": 1,
        "images": 3,
        "rows": {"standard, by pointer": figures},
    }
    daemons = {
        "benchmark": "graph_daemon",
        "machine": MACHINE,
        "title": "16 nodes",
        "storms": 1,
        "subjects": {OURS.name: WELL, STOCK.name: BADLY},
    }
    files = []
    for document in (crash, images, daemons):
        files.append(tmp_path / f"{document['benchmark']}.json")
        files[-1].write_text(json.dumps(document), encoding="utf-8")
    publish(files, page)
    once = page.read_text(encoding="utf-8")
    assert "10 of 10" in once or "0 of 10" in once
    assert {path.stem for path in tmp_path.glob("*.svg")} == {
        "crash",
        "intra_process",
        "graph_daemon",
    }
    publish(files, page, "a note")
    assert "\na note\n" in page.read_text(encoding="utf-8")
    publish(files, page)
    assert page.read_text(encoding="utf-8") == once


def test_a_page_without_a_place_is_left_alone() -> None:
    with pytest.raises(PageError, match="crash"):
        put("<!-- crash -->\n", "crash", "figures")
    page = put("a\n<!-- x -->\nold\n<!-- /x -->\nb\n", "x", "new")
    assert page == "a\n<!-- x -->\nnew\n<!-- /x -->\nb\n"
