"""The benchmarks run: a few crashes and a few images are enough to see that they measure."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from benchmarks.intra_process import DDS, ISOLATED, STANDARD
from tests.support.isolated import allocator_environment
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


def crash(folder: Path, *arguments: str) -> list[dict[str, Any]]:
    """The rows that it measured, with pictures drawn on the way."""
    allocator_environment()
    stored, plot = folder / "crash.json", folder / "crash.svg"
    printed = run("crash", "--count", "3", *arguments, "--json", stored, "--plot", plot)
    assert ET.fromstring(plot.read_text(encoding="utf-8")).tag.endswith("svg")
    document = json.loads(stored.read_text(encoding="utf-8"))
    assert document["benchmark"] == "crash"
    rows: list[dict[str, Any]] = document["rows"]
    assert all(row["kind"] in printed for row in rows[1:])
    assert rows[0]["kind"] == "none/nowhere"
    assert rows[0]["gap_ms"]["count"] > 0
    return rows[1:]


@pytest.mark.parametrize("mode", ["isolated", "isolated_mt"])
def test_crashes_of_every_place_are_measured(tmp_path: Path, mode: str) -> None:
    kinds = "segv/callback,exception/constructor,kill/thread,abrt/malloc,segv/outside"
    rows = crash(tmp_path, "--modes", mode, "--kinds", kinds, "--unquiesced", "")
    assert {row["kind"] for row in rows} == set(kinds.split(","))
    for row in rows:
        assert row["complete"], row
        assert row["missed"] == 0, row
        # A death that leaves a lock is rare, but possible; there are some more then.
        assert row["crashes"] >= 3
        assert row["crashes"] == 3 or row["restarts"] > 0
        assert row["event_ms"]["count"] == row["crashes"]
        assert row["event_ms"]["min"] > 0
        # What crashes while others are not there again after a restart is not measured.
        if row["restarts"] == 0:
            assert row["loaded_ms"]["count"] == row["crashes"]
        if row["loaded_ms"]:
            assert row["loaded_ms"]["min"] > row["event_ms"]["min"]


def test_dying_without_quiescing_is_measured(tmp_path: Path) -> None:
    arguments = ("--modes", "isolated", "--kinds", "segv/thread", "--unquiesced", "segv/thread")
    quiesced, unquiesced = crash(tmp_path, *arguments)
    assert quiesced["quiesced"]
    assert not unquiesced["quiesced"]
    assert unquiesced["crashes"] >= unquiesced["wanted"] == 1
    assert unquiesced["doubtful"] > 0


def test_images_are_measured(tmp_path: Path) -> None:
    allocator_environment()
    names = [STANDARD, ISOLATED, DDS]
    stored, plot = tmp_path / "images.json", tmp_path / "images.svg"
    arguments = ["--rounds", "2", "--images", "5", "--variants", ";".join(names)]
    printed = run("intra_process", *arguments, "--json", stored, "--plot", plot)
    assert f"{ISOLATED} / {STANDARD}" in printed
    assert f"{DDS} / {ISOLATED}" in printed
    rows = json.loads(stored.read_text(encoding="utf-8"))["rows"]
    assert list(rows) == names
    assert all(row["count"] == 10 and row["min"] > 0 for row in rows.values())
    assert ET.fromstring(plot.read_text(encoding="utf-8")).tag.endswith("svg")


def test_a_control_loop_is_measured_beside_a_greedy_node(tmp_path: Path) -> None:
    allocator_environment()
    stored = tmp_path / "limits.json"
    printed = run("limits", "--rounds", "1", "--seconds", "0.2", "--json", stored)
    document = json.loads(stored.read_text(encoding="utf-8"))
    rows, left_out = document["rows"], document["left_out"]
    assert {"alone", "beside the greedy node"} <= {*rows}
    assert "launch file, one container" in {*rows, *left_out}
    assert not rows.keys() & left_out.keys()
    for name in rows:
        assert name in printed
    for name, why in left_out.items():
        assert f"{name}: not measured, {why}" in printed
        assert why


def test_a_kind_that_does_not_exist_is_refused() -> None:
    result = subprocess.run(
        [sys.executable, "-m", "benchmarks.crash", "--kinds", "boredom/*"],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 1
    assert "segv/callback" in result.stderr


def test_recording_at_rest_is_measured_with_and_without_samples() -> None:
    small = ("--containers", "1", "--nodes", "2", "--runs", "1", "--settle", "2")
    for seconds in ("2", "10", "30"):  # a busy machine may have no time for a sample meanwhile
        figures = json.loads(run("sampling", *small, "--seconds", seconds, "--json"))
        (sampled,), (not_sampled,) = figures["sampled"], figures["not sampled"]
        if sampled["size"] > 0:
            break
    assert sampled["cpu"] > 0
    assert sampled["size"] > 0, "there was a sample meanwhile"
    assert not_sampled["cpu"] >= 0


def test_what_others_notice_of_a_change_is_measured() -> None:
    (parts,) = json.loads(run("apply", "--runs", "1", "--seconds", "0.5", "--json"))
    assert set(parts) == {"nothing", "four changes", "a parameter"}
    for part in parts.values():
        assert (part["missing"], part["began_anew"]) == (0, 0)
        assert part["late_heard"] > -50, "something was heard"
    assert parts["four changes"]["seconds"] > 0


def test_what_outlives_a_supervisor_is_counted() -> None:
    mounted("true", "true")  # skips where the benchmark could not have its own /dev/shm
    (trial,) = json.loads(run("orphans", "--trials", "1", "--json"))
    assert trial["phase"] == "start"
    assert trial["orphans"] == []
