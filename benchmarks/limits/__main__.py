"""The jitter of a 1 kHz control node beside a greedy one, with and without `resources`.

    python -m benchmarks.limits [--rounds N] [--seconds S] [--json FILE] [--quick]

Both are nodes of one isolated container. The control node's timer says by how much each of its
beats is late; the greedy node computes on as many threads as there are CPUs. The ways take turns,
so that a change in the machine's speed meets all of them. What this machine does not have is named,
with the reason; so is launch of ROS, which runs the same two nodes in one container where it can be
imported.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from benchmarks.figures import Figures
from benchmarks.intra_process import Failures
from benchmarks.limits.stock_launch import STOCK, launched, obstacle
from benchmarks.limits.ways import Way, ways
from benchmarks.machine import machine
from benchmarks.progress import Progress
from benchmarks.statistics import Summary
from benchmarks.systems import Node, keep_to_this_machine, system
from play_launch.runtime.publisher import Publisher
from play_launch.runtime.run import run_system
from play_launch.runtime.signals import StopRequests

RATE: Final = 1000.0
_SETTLE: Final = 0.5
"""Seconds from the first beat, or the start of the greedy node, to the measured part."""
_TIMEOUT: Final = 60.0
_COUNT, _MISSED, _HEADER = 1, 2, 3
# What ControlLoop leaves before its samples.
_LOOK_EVERY: Final = 0.05
_US: Final = 1e3
"""Nanoseconds."""


@dataclass
class Row:
    """What was measured of one way; times are microseconds."""

    late: list[float] = field(default_factory=list)
    missed: int = 0
    """Periods without a beat."""
    load: float = 0.0
    """Of the machine, the highest, the greedy node included."""


async def measure(way: Way, seconds: float, row: Row) -> None:
    """Add a round to a row; SystemExit when the nodes do not come up."""
    failures = Failures()
    stop = StopRequests()
    with _figures(seconds) as figures:
        nodes = [Node("control", "ControlLoop", _control(seconds), resources=way.control)]
        if not way.is_alone:
            nodes.append(Node("greedy", "Greedy", resources=way.greedy))
        config = system("isolated", nodes, environment=figures.environment)
        publisher = Publisher(failures)
        running = asyncio.ensure_future(run_system(config, publisher, stop))
        try:
            await _until(lambda: publisher.view.loaded == len(nodes), way.name, failures)
            await _collect(figures, seconds, row)
            if failures.texts:
                raise SystemExit(f"{way.name}: {'; '.join(failures.texts)}")
            stop.request(reason="the benchmark is done")
            await running
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)


async def measure_stock(seconds: float, row: Row) -> None:
    """Add a round of both nodes under a launch file."""
    with _figures(seconds) as figures:
        async with launched(_control(seconds), figures.environment):
            await _until(lambda: figures[_COUNT] > 0, STOCK, Failures())
            await _collect(figures, seconds, row)


def _room(seconds: float) -> int:
    """How many beats fit: also those while all comes up."""
    return round((seconds + 2 * _TIMEOUT) * RATE)


def _figures(seconds: float) -> Figures:
    return Figures(_HEADER + _room(seconds))


def _control(seconds: float) -> dict[str, object]:
    return {"figures": 0, "samples": _room(seconds), "rate": RATE}


async def _until(is_up: Callable[[], bool], name: str, failures: Failures) -> None:
    deadline = time.monotonic() + _TIMEOUT
    while not is_up():
        if failures.texts or time.monotonic() > deadline:
            why = "; ".join(failures.texts) or "no reason is known"
            raise SystemExit(f"{name}: the nodes do not come up: {why}")
        await asyncio.sleep(_LOOK_EVERY)


async def _collect(figures: Figures, seconds: float, row: Row) -> None:
    await asyncio.sleep(_SETTLE)
    before, missed = figures.read(_COUNT, 2)
    await asyncio.sleep(seconds)
    after, missed_by_now = figures.read(_COUNT, 2)
    row.load = max(row.load, os.getloadavg()[0])
    row.late += [ns / _US for ns in figures.read(_HEADER + before, after - before)]
    row.missed += missed_by_now - missed


def table(
    rows: Mapping[str, Summary], missed: Mapping[str, int], left_out: Mapping[str, str]
) -> str:
    """A line for each way; what could not be measured comes last, with the reason."""
    heading = f"{'a beat is late by':<30}{'median':>10}{'p99':>10}{'max':>10}   {'missed':>7}"
    lines = [heading]
    for name, s in rows.items():
        share = 100 * missed[name] / (s.count + missed[name])
        lines.append(f"{name:<30}{s.p50:10.0f}{s.p99:10.0f}{s.max:10.0f} us{share:7.2f} %")
    lines += [f"{name}: not measured, {why}" for name, why in left_out.items()]
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> None:
    arguments = _arguments(words)
    logging.getLogger("play_launch").addHandler(logging.NullHandler())
    keep_to_this_machine()
    known = ways()
    rows = {way.name: Row() for way in known if not way.obstacle}
    left_out = {way.name: way.obstacle for way in known if way.obstacle}
    if why := obstacle():
        left_out[STOCK] = why
    else:
        rows[STOCK] = Row()
    progress = Progress()
    for turn in range(arguments.rounds):
        for way in known:
            if not way.obstacle:
                progress.tell(f"round {turn + 1} of {arguments.rounds}: {way.name}", force=True)
                asyncio.run(measure(way, arguments.seconds, rows[way.name]))
        if STOCK in rows:
            asyncio.run(measure_stock(arguments.seconds, rows[STOCK]))
    found = {name: Summary.of(row.late) for name, row in rows.items()}
    summaries = {name: summary for name, summary in found.items() if summary is not None}
    left_out |= dict.fromkeys(rows.keys() - summaries.keys(), "no beat came")
    print(
        f"{RATE:g} Hz beside as many greedy threads as CPUs ({os.cpu_count()}), "
        f"{arguments.rounds} x {arguments.seconds:g} s of each, nice {os.nice(0)}, "
        f"load {max(row.load for row in rows.values()):.0f} at most"
    )
    print(table(summaries, {name: row.missed for name, row in rows.items()}, left_out))
    if arguments.json is not None:
        document: dict[str, Any] = {
            "benchmark": "limits",
            "machine": machine(),
            "rounds": arguments.rounds,
            "seconds": arguments.seconds,
            "nice": os.nice(0),
            "rows": {
                name: summary.as_json() | {"missed": rows[name].missed, "load": rows[name].load}
                for name, summary in summaries.items()
            },
            "left_out": left_out,
        }
        arguments.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="benchmarks.limits",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--rounds", type=int, default=None, help="turns of each way (3)")
    parser.add_argument("--seconds", type=float, default=None, help="of each turn (5)")
    parser.add_argument("--json", type=Path, default=None)
    parser.add_argument("--quick", action="store_true", help="1 turn of 1 s")
    arguments = parser.parse_args(words)
    arguments.rounds = arguments.rounds or (1 if arguments.quick else 3)
    arguments.seconds = arguments.seconds or (1.0 if arguments.quick else 5.0)
    if arguments.rounds < 1 or arguments.seconds <= 0:
        parser.error("rounds and seconds are above 0")
    return arguments


if __name__ == "__main__":
    main()
