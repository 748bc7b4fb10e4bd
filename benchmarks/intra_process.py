"""A 2 MB message from one node to another: by pointer, and between processes.

    python -m benchmarks.intra_process [--rounds N] [--images N] [--rate HZ] [--json FILE]
                                       [--quick]

The time from publishing to the callback: in a container of the mode `standard`, between two
isolated nodes, and between two nodes of the mechanism `process`, whose messages go through DDS. The
variants take turns, so that a change in the machine's speed meets all of them.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from benchmarks.figures import Figures
from benchmarks.goal import Goal
from benchmarks.machine import machine
from benchmarks.progress import Progress
from benchmarks.statistics import Summary
from benchmarks.systems import Node, keep_to_this_machine, system
from play_launch.runtime.publisher import Publisher
from play_launch.runtime.run import run_system
from play_launch.runtime.signals import StopRequests
from play_launch.supervisor.events import NodeState, NodeStateChanged, RunEvent
from play_launch.supervisor.view import SystemView

BYTES: Final = 2_000_000
LARGE_SEGMENT: Final = Path(__file__).parents[1] / "fixtures" / "fastdds" / "large_segment.xml"
MOST_OF_STANDARD, LEAST_OF_DDS = 1.2, 20.0
"""The goals: `isolated` takes at most so many times as long as `standard`, and DDS at least."""
_WARM_UP: Final = 10
_TIMEOUT: Final = 30.0
"""Seconds beyond the time that the images take."""
_LOOK_EVERY: Final = 0.05
# What ImageTimer leaves before its samples.
_COUNT, _BY_POINTER, _LAST_BYTES, _HEADER = 1, 2, 3, 4
_US: Final = 1e3
"""Nanoseconds."""


@dataclass(frozen=True, slots=True)
class Variant:
    """A way for messages to go."""

    name: str
    mode: str
    isolation: str = ""
    by_pointer: bool = True
    environment: Mapping[str, str] = field(default_factory=dict)


VARIANTS: Final = (
    Variant("standard, by pointer", "standard"),
    Variant("mt, by pointer", "mt"),
    Variant("isolated, by pointer", "isolated"),
    Variant("isolated_mt, by pointer", "isolated_mt"),
    Variant("process, over DDS", "isolated", isolation="process", by_pointer=False),
    Variant(
        "process, over DDS, 4 MiB segments",
        "isolated",
        isolation="process",
        by_pointer=False,
        environment={"FASTRTPS_DEFAULT_PROFILES_FILE": str(LARGE_SEGMENT)},
    ),
)
STANDARD, THREADS, ISOLATED, _, DDS, LARGE_DDS = (variant.name for variant in VARIANTS)


class Failures:
    """Hears the supervisor's events and remembers what failed."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        del before, after
        if isinstance(event, NodeStateChanged) and event.state in {
            NodeState.LOAD_FAILED,
            NodeState.CRASHED,
            NodeState.LOST,
        }:
            self.texts.append(f"{event.node}: {event.state}: {event.reason}")


async def measure(variant: Variant, images: int, rate: float) -> list[float]:
    """Times of that many images, in microseconds.

    Raises:
        SystemExit: When they do not come, or not in the way that they should.
    """
    wanted = images + _WARM_UP
    failures = Failures()
    stop = StopRequests()
    with Figures(_HEADER + wanted) as figures:
        nodes = [
            Node("image_timer", "ImageTimer", {"figures": 0, "samples": wanted}),
            Node("image_source", "ImageSource", {"rate": rate, "bytes": BYTES}),
        ]
        config = system(
            variant.mode,
            nodes,
            environment={**figures.environment, **variant.environment},
            isolation=variant.isolation,
        )
        running = asyncio.ensure_future(run_system(config, Publisher(failures), stop))
        try:
            deadline = time.monotonic() + wanted / rate + _TIMEOUT
            while figures[_COUNT] < wanted and not failures.texts and not running.done():
                if time.monotonic() > deadline:
                    break
                await asyncio.sleep(_LOOK_EVERY)
            stop.request(reason="the benchmark is done")
            await running
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)
        came, by_pointer, size = figures.read(_COUNT, _HEADER - _COUNT)
        if came < wanted or size != BYTES:
            why = "; ".join(failures.texts) or "no reason is known"
            raise SystemExit(f"{variant.name}: {came} of {wanted} images came: {why}")
        if (by_pointer == came) is not variant.by_pointer:
            raise SystemExit(f"{variant.name}: {by_pointer} of {came} images came by pointer")
        return [ns / _US for ns in figures.read(_HEADER + _WARM_UP, images)]


def goals(rows: Mapping[str, Summary]) -> list[Goal]:
    """The ratios of medians against the goals; those of what was measured."""
    medians = {name: summary.p50 for name, summary in rows.items()}
    found = []
    if ISOLATED in medians and STANDARD in medians:
        ratio = medians[ISOLATED] / medians[STANDARD]
        measured = f"{ratio:.2f} x"
        if THREADS in medians:
            measured += f" ({medians[ISOLATED] / medians[THREADS]:.2f} x {THREADS})"
        goal = f"at most {MOST_OF_STANDARD} x"
        met = ratio <= MOST_OF_STANDARD
        found.append(Goal(f"{ISOLATED} / {STANDARD}", goal, measured, met))
    for dds in (DDS, LARGE_DDS):
        if ISOLATED in medians and dds in medians:
            ratio = medians[dds] / medians[ISOLATED]
            goal = f"at least {LEAST_OF_DDS:.0f} x"
            met = ratio >= LEAST_OF_DDS
            found.append(Goal(f"{dds} / {ISOLATED}", goal, f"{ratio:.0f} x", met))
    return found


def table(rows: Mapping[str, Summary]) -> str:
    lines = [f"{'':<36}{'min':>9}{'median':>9}{'p99':>9}{'max':>9}"]
    for name, s in rows.items():
        lines.append(f"{name:<36}{s.min:9.0f}{s.p50:9.0f}{s.p99:9.0f}{s.max:9.0f} us")
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> None:
    arguments = _arguments(words)
    logging.getLogger("play_launch").addHandler(logging.NullHandler())
    keep_to_this_machine()
    times: dict[str, list[float]] = {variant.name: [] for variant in arguments.variants}
    progress = Progress()
    for turn in range(arguments.rounds):
        for variant in arguments.variants:
            progress.tell(f"round {turn + 1} of {arguments.rounds}: {variant.name}", force=True)
            times[variant.name] += asyncio.run(measure(variant, arguments.images, arguments.rate))
    rows = {name: Summary.of(values) for name, values in times.items()}
    found = {name: summary for name, summary in rows.items() if summary is not None}
    print(f"2 MB images at {arguments.rate:g} Hz, {arguments.rounds} x {arguments.images} of each")
    print(table(found))
    for goal in goals(found):
        print(goal.line)
    if arguments.json is not None:
        document: dict[str, Any] = {
            "benchmark": "intra_process",
            "machine": machine(),
            "rate": arguments.rate,
            "rounds": arguments.rounds,
            "images": arguments.images,
            "rows": {name: summary.as_json() for name, summary in found.items()},
        }
        arguments.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _variants(text: str) -> list[Variant]:
    parts = [part.strip() for part in text.split(";")]
    chosen = [variant for variant in VARIANTS if variant.name in parts]
    if len(chosen) != len(parts):
        names = "; ".join(variant.name for variant in VARIANTS)
        raise argparse.ArgumentTypeError(f"some of: {names}")
    return chosen


def _arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="benchmarks.intra_process",
        description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )
    parser.add_argument("--rounds", type=int, default=None, help="turns of each variant (5)")
    parser.add_argument("--images", type=int, default=None, help="in each turn (200)")
    parser.add_argument("--rate", type=float, default=30.0, help="images per second")
    parser.add_argument(
        "--variants", type=_variants, default=list(VARIANTS), help="names, separated by ;"
    )
    parser.add_argument("--json", type=Path, default=None)
    parser.add_argument("--quick", action="store_true", help="1 turn of 30 images")
    arguments = parser.parse_args(words)
    arguments.rounds = arguments.rounds or (1 if arguments.quick else 5)
    arguments.images = arguments.images or (30 if arguments.quick else 200)
    if arguments.rounds < 1 or arguments.images < 1 or arguments.rate <= 0:
        parser.error("--rounds, --images and --rate must be above 0")
    if arguments.json is not None and not arguments.json.parent.is_dir():
        parser.error(f"there is no folder {arguments.json.parent}")
    return arguments


if __name__ == "__main__":
    main()
