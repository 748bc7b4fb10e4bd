"""The rules of the Trace Event Format, as far as our traces use it."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

FIELDS = {
    "X": {"ph", "cat", "name", "pid", "tid", "ts", "dur", "args"},
    "i": {"ph", "cat", "name", "pid", "tid", "ts", "s", "args"},
    "C": {"ph", "name", "pid", "tid", "ts", "args"},
    "M": {"ph", "name", "pid", "tid", "args"},
}
METADATA = {
    "process_name": ("name", str),
    "thread_name": ("name", str),
    "process_sort_index": ("sort_index", int),
    "thread_sort_index": ("sort_index", int),
}
ROUNDING = 0.002
"""Microseconds: times are written in thousandths."""


def _refuse(constant: str) -> None:
    raise AssertionError(f"{constant} is no JSON")


def read_trace(path: Path) -> list[dict[str, Any]]:
    """Read a trace and check each of its events, and that slices of a track do not overlap."""
    document = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse)
    assert document.keys() == {"displayTimeUnit", "traceEvents", "otherData"}
    assert document["displayTimeUnit"] in {"ms", "ns"}
    events: list[dict[str, Any]] = document["traceEvents"]
    for event in events:
        _check(event)
    _check_names(events)
    _check_slices(events)
    return events


def _check(event: dict[str, Any]) -> None:
    assert event.keys() == FIELDS[event["ph"]], event
    assert isinstance(event["name"], str)
    assert event["name"]
    assert isinstance(event["args"], dict)
    for number in ("pid", "tid"):
        assert type(event[number]) is int
        assert event[number] >= 0
    for time in event.keys() & {"ts", "dur"}:
        assert isinstance(event[time], int | float)
        assert event[time] >= 0, event
    match event["ph"]:
        case "i":
            assert event["s"] in {"g", "p", "t"}
        case "C":
            assert event["args"], "a counter counts something"
            assert all(math.isfinite(value) for value in event["args"].values())
        case "M":
            name, kind = METADATA[event["name"]]
            assert event["args"].keys() == {name}
            assert isinstance(event["args"][name], kind)


def _check_names(events: list[dict[str, Any]]) -> None:
    processes = [event for event in events if event["name"] == "process_name"]
    threads = [event for event in events if event["name"] == "thread_name"]
    assert len({event["pid"] for event in processes}) == len(processes), "named once"
    assert len({event["args"]["name"] for event in processes}) == len(processes)
    assert len({(event["pid"], event["tid"]) for event in threads}) == len(threads)
    named = {event["pid"] for event in processes}
    assert {event["pid"] for event in events} == named
    tracks = {(event["pid"], event["tid"]) for event in threads}
    assert {(event["pid"], event["tid"]) for event in events if event["ph"] in "Xi"} <= tracks


def _check_slices(events: list[dict[str, Any]]) -> None:
    ended: dict[tuple[int, int], float] = {}
    slices = [event for event in events if event["ph"] == "X"]
    for event in sorted(slices, key=lambda event: (event["ts"], event["dur"])):
        track = event["pid"], event["tid"]
        assert event["ts"] >= ended.get(track, 0.0) - ROUNDING, "one state at a time"
        ended[track] = event["ts"] + event["dur"]
