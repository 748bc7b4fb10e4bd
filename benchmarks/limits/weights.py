"""What `cpu_weight` is worth on a CPU that two nodes want.

    python -m benchmarks.limits.weights [--windows N] [--seconds S]

Takes the controllers of control groups; a machine that has them runs it by

    python -m tests.guest benchmarks/limits/weights_in_guest

All nodes run all the time on one CPU; what changes, every fraction of a second and in turn, is the
weight of their groups, so that whatever disturbs the machine meets all of them. Measured is first
how much two greedy nodes get done, by their CPU time, then by how much the beats of a 1 kHz control
node are late beside one. While that is of the class idle it makes room at once, and the CPU is as
busy as with any weight: so this is what the machine can do.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

from benchmarks.figures import Figures
from benchmarks.limits.ways import groups_problem
from benchmarks.statistics import Summary
from benchmarks.systems import Node, keep_to_this_machine, system
from play_launch.process.cgroups.group import Group
from play_launch.process.cgroups.usage import group_of
from play_launch.runtime.publisher import Publisher
from play_launch.runtime.run import run_system
from play_launch.runtime.signals import StopRequests
from play_launch.supervisor.events import NodeState, NodeStateChanged, RunEvent
from play_launch.supervisor.view import SystemView

_RATE: Final = 1000.0
_BEATS, _HEADER = 1, 3
# What ControlLoop leaves: its pid, the number of beats, that of missed ones, then the samples.
_SETTLE: Final = 0.4
"""Seconds after a change, which are not measured: what one got too little of before comes first."""
_TIMEOUT: Final = 120.0
_US: Final = 1e3
_CPU: Final = [0]


@dataclass(frozen=True, slots=True)
class Weights:
    """Of the node that is looked at, and of its greedy neighbour; 0: that has the class idle."""

    own: int
    greedy: int

    def __str__(self) -> str:
        return f"{self.own} to {self.greedy}" if self.greedy else "neighbour of the class idle"


WORK: Final = (Weights(100, 100), Weights(1000, 10), Weights(10, 1000), Weights(10_000, 1))
BEATS: Final = (Weights(100, 0), Weights(100, 100), Weights(10_000, 1))


@dataclass
class Row:
    """What was measured with one pair of weights."""

    shares: list[float] = field(default_factory=list)
    """Percent of what both used that the first one had, one for each window."""
    late: list[float] = field(default_factory=list)
    """Microseconds."""
    missed: int = 0
    """Periods without a beat."""


class _Pids:
    """Hears which process each node has."""

    def __init__(self) -> None:
        self.found: dict[str, int] = {}
        self.are_complete = asyncio.Event()

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        del before, after
        if isinstance(event, NodeStateChanged) and event.state is NodeState.LOADED:
            self.found[event.node] = event.pid
            if {"/own", "/greedy"} <= self.found.keys():
                self.are_complete.set()


async def measure(
    own: Node, turns: Sequence[Weights], windows: int, seconds: float, figures: Figures
) -> dict[Weights, Row]:
    """Bring a node and a greedy one up and let the weights take turns."""
    rows = {turn: Row() for turn in turns}
    stop, pids = StopRequests(), _Pids()
    both = {"cpuset": _CPU, "cpu_weight": 100}
    greedy_node = Node("greedy", "Greedy", {"threads": 1}, resources=both)
    own = Node("own", own.plugin, own.parameters, resources=both)
    # With memory of their own: a node that gets next to no time keeps no lock that the other needs.
    config = system(
        "isolated", [own, greedy_node], environment=figures.environment, isolation="process"
    )
    running = asyncio.ensure_future(run_system(config, Publisher(pids), stop))
    try:
        async with asyncio.timeout(_TIMEOUT):
            await pids.are_complete.wait()
        first, second = (_group(pids.found[name]) for name in ("/own", "/greedy"))
        for _ in range(windows):
            for turn in turns:
                _set(first, second, turn)
                await asyncio.sleep(_SETTLE)
                await _measure(figures, first, second, seconds, rows[turn])
        stop.request(reason="the benchmark is done")
        await running
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
    return rows


def _group(pid: int) -> Group:
    group = group_of(pid)
    if group is None:
        raise SystemExit("the nodes have no control groups")
    return group


def _set(own: Group, greedy: Group, turn: Weights) -> None:
    (greedy.path / "cpu.idle").write_text("0" if turn.greedy else "1")
    (own.path / "cpu.weight").write_text(str(turn.own))
    if turn.greedy:
        (greedy.path / "cpu.weight").write_text(str(turn.greedy))


async def _measure(figures: Figures, own: Group, greedy: Group, seconds: float, row: Row) -> None:
    beats, missed = figures.read(_BEATS, 2)
    before = [_used(group) for group in (own, greedy)]
    await asyncio.sleep(seconds)
    first, second = (_used(g) - b for g, b in zip((own, greedy), before, strict=True))
    beats_by_now, missed_by_now = figures.read(_BEATS, 2)
    row.late += [ns / _US for ns in figures.read(_HEADER + beats, beats_by_now - beats)]
    row.missed += missed_by_now - missed
    if first + second:
        row.shares.append(100 * first / (first + second))


def _used(group: Group) -> int:
    return group.numbers("cpu.stat")["usage_usec"]


def _work_line(turn: Weights, row: Row) -> str:
    share = 100 * turn.own / (turn.own + turn.greedy)
    low, *_, high = statistics.quantiles(row.shares, n=10)
    middle = statistics.median(row.shares)
    return f"{turn!s:<30}{share:12.2f} %{middle:12.2f} %{low:10.2f} % to {high:.2f} %"


def _beat_line(turn: Weights, row: Row) -> str:
    found = Summary.of(row.late)
    if found is None:
        return f"{turn!s:<30} no beat came"
    missed = 100 * row.missed / (found.count + row.missed)
    return f"{turn!s:<30}{found.p50:10.0f}{found.p99:10.0f}{found.max:10.0f} us{missed:8.2f} %"


def _print(heading: str, rows: dict[Weights, Row], line: Callable[[Weights, Row], str]) -> None:
    print("\n".join([heading, *(line(turn, row) for turn, row in rows.items())]), flush=True)


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="benchmarks.limits.weights",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--windows", type=int, default=25, help="of each pair of weights (25)")
    parser.add_argument("--seconds", type=float, default=0.3, help="of each window (0.3)")
    arguments = parser.parse_args(words)
    if why := groups_problem():
        raise SystemExit(f"not measured: {why}")
    keep_to_this_machine()
    windows, seconds = arguments.windows, arguments.seconds
    # A host may have no time for a virtual machine: far more than the windows take.
    room = round((windows * len(BEATS) * (seconds + _SETTLE) * 4 + 2 * _TIMEOUT) * _RATE)
    beats = {"figures": 0, "samples": room, "rate": _RATE}
    print(f"{windows} x {seconds:g} s of each, load {os.getloadavg()[0]:.0f}")
    with Figures(_HEADER + room) as figures:
        worker = Node("own", "Greedy", {"threads": 1})
        rows = asyncio.run(measure(worker, WORK, windows, seconds, figures))
        heading = (
            f"{'weights: a node does':<30}{'by weight':>14}{'median':>14}{'80 % of windows':>22}"
        )
        _print(heading, rows, _work_line)
    with Figures(_HEADER + room) as figures:
        control = Node("own", "ControlLoop", beats)
        rows = asyncio.run(measure(control, BEATS, windows, seconds, figures))
        heading = f"{'weights: a beat is late by':<30}{'median':>10}{'p99':>10}{'max':>10}"
        _print(f"{heading}   {'missed':>9}", rows, _beat_line)


if __name__ == "__main__":
    main()
