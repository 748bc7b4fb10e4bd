"""Tables hold every sample and every state, and are read by others."""

from __future__ import annotations

import csv
import importlib
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from play_launch.cli import export as export_verb
from play_launch.cli.export import export as export_session
from play_launch.postmortem.export import tables
from play_launch.supervisor.events import (
    GroupSample,
    NodeStateChanged,
    ProcessSample,
    RunEvent,
    SystemSample,
)
from tests.postmortem.test_past_session import EVERYTHING, record
from tests.recording.test_states import EVENTS, PROCESS_SAMPLES, SYSTEM_SAMPLES


def exported(events: list[RunEvent], form: export_verb.Format, folder: Path) -> dict[str, Path]:
    path = record(folder / "x.mcap", events)
    assert export_session(path, form, None) == 0
    return {file.stem: file for file in (folder / f"x-{form}").glob("*")}


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@settings(max_examples=40)
@given(st.lists(EVERYTHING, max_size=12))
def test_no_sample_and_no_state_is_missing(events: list[RunEvent]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        written = exported(events, "csv", Path(folder))
        found = {name: read_csv(path) for name, path in written.items()}
    processes = [event for event in events if isinstance(event, ProcessSample)]
    assert [row["key"] for row in found.get("processes", [])] == [one.key for one in processes]
    for row, one in zip(found.get("processes", []), processes, strict=True):
        assert int(row["stamp_ns"]) == one.stamp_ns
        assert row["kind"] == one.kind.name.lower()
        assert row["memory_kind"] == one.memory_kind.name.lower()
        assert int(row["memory_bytes"]) == one.memory_bytes
    groups = [event for event in events if isinstance(event, GroupSample)]
    rows = found.get("cgroups", [])
    assert [row["key"] for row in rows] == [one.key for one in groups]
    assert [int(row["oom_kills"]) for row in rows] == [one.oom_kills for one in groups]
    machine = [event for event in events if isinstance(event, SystemSample)]
    assert len(found.get("machine", [])) == len(machine)
    nodes = [event for event in events if isinstance(event, NodeStateChanged)]
    rows = [row for row in found.get("states", []) if row["kind"] == "node"]
    assert [row["state"] for row in rows] == [one.state.name.lower() for one in nodes]
    assert [row["reason"] for row in rows] == [one.reason for one in nodes]


def some(strategy: st.SearchStrategy[Any], count: int) -> list[RunEvent]:
    found: list[RunEvent] = []

    @settings(max_examples=count, database=None)
    @given(strategy)
    def draw(event: RunEvent) -> None:
        found.append(event)

    draw()
    return found


def test_parquet_has_the_same_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parquet = importlib.import_module("pyarrow.parquet")
    monkeypatch.setattr(tables, "_BATCH", 7)
    events = some(PROCESS_SAMPLES, 20) + some(EVENTS, 20)
    as_csv, as_parquet = exported(events, "csv", tmp_path), exported(events, "parquet", tmp_path)
    assert as_parquet.keys() == as_csv.keys() == {"processes", "states"}
    for name, path in as_parquet.items():
        rows = parquet.read_table(path).to_pylist()
        plain = read_csv(as_csv[name])
        assert [*rows[0]] == [*plain[0]]
        for row, same in zip(rows, plain, strict=True):
            assert row["key"] == same["key"]
            assert row["stamp_ns"] == int(same["stamp_ns"])


def test_what_is_no_number_is_empty(tmp_path: Path) -> None:
    (event,) = some(SYSTEM_SAMPLES, 1)
    assert isinstance(event, SystemSample)
    values = {name: getattr(event, name) for name in SystemSample.__struct_fields__}
    events: list[RunEvent] = [
        SystemSample(**{**values, "core_percent": (1.0, 2.0), "steal_percent": float("nan")}),
        SystemSample(**{**values, "core_percent": (3.0,)}),
        SystemSample(**{**values, "core_percent": (4.0, 5.0, 6.0)}),
    ]
    rows = read_csv(exported(events, "csv", tmp_path)["machine"])
    assert rows[0]["steal_percent"] == ""
    assert [row["core_0_percent"] for row in rows] == ["1.0", "3.0", "4.0"]
    assert [row["core_1_percent"] for row in rows] == ["2.0", "", "5.0"]


def test_without_pyarrow_the_error_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(export_verb, "find_spec", lambda _: None)
    path = record(tmp_path / "x.mcap", [])
    with pytest.raises(SystemExit) as ended:
        export_session(path, "parquet", None)
    assert ended.value.code == 2
    assert "pip install 'play-launch-py[parquet]', or use csv" in capsys.readouterr().err
