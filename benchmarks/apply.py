"""Changes one node in ten of a system that exchanges messages; what the others notice of it.

    python -m benchmarks.apply [--runs N] [--rate HZ] [--seconds S] [--json]

Each run brings up 30 nodes in three containers (standard, isolated, isolated_mt). Each node says
numbers that the next one hears, over DDS. After some seconds in which nothing happens, and which
show what the machine itself does, `play-launch apply` sets a parameter of one node, changes a
remapping of another, takes one out and adds one. Then `apply` sets the parameter back, which finds
the supervisor in the graph already. What the nodes notice that are not touched:

- numbers that are missing, and lives that began anew: there may be none;
- the longest time between two messages, above the period of their timers.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks import correspondence
from benchmarks import running as a_system
from benchmarks.bring_up import COMMAND, ENVIRONMENT, TIMEOUT
from benchmarks.correspondence import forget_gaps, noticed
from benchmarks.figures import Figures
from benchmarks.statistics import header, row

GOAL = 20.0
"""Milliseconds above the period."""
AFTER = 0.5
"""Seconds after an `apply` that still count as its time."""
HEARD = 20
"""Messages until a node counts as settled."""


class Part(NamedTuple):
    """What nodes that are not touched noticed in a part of a run; times in ms."""

    seconds: float
    missing: int
    began_anew: int
    late_heard: float
    """Above the period, the longest of all nodes."""
    late_said: float
    load: float
    """Of the machine, for each processor."""
    stolen: float
    """Percent of the processors' time that their host gave to others."""


class Watch:
    """Looks at what the nodes notice in the time of a block."""

    def __init__(self, figures: Figures, period: float) -> None:
        self._figures = figures
        self._period = period
        self._numbers = correspondence.untouched()

    def settle(self) -> None:
        """Wait until every node hears another one."""
        every_node = range(correspondence.NODES)
        deadline = time.monotonic() + TIMEOUT
        while min(each.heard for each in noticed(self._figures, every_node).values()) < HEARD:
            if time.monotonic() > deadline:
                raise SystemExit("not all nodes hear another one")
            time.sleep(0.1)

    def part(self, work: Any) -> Part:
        """Measure while ``work()`` runs, which returns the seconds that it took."""
        before, cpu = noticed(self._figures, self._numbers), processor_times()
        forget_gaps(self._figures, self._numbers)
        seconds = work()
        after, cpu = noticed(self._figures, self._numbers), processor_times(cpu)
        return Part(
            seconds=seconds,
            missing=sum(after[n].missing - before[n].missing for n in self._numbers),
            began_anew=sum(after[n].began_anew - before[n].began_anew for n in self._numbers),
            late_heard=self._late(max(each.longest_between_heard for each in after.values())),
            late_said=self._late(max(each.longest_between_said for each in after.values())),
            load=os.getloadavg()[0] / len(os.sched_getaffinity(0)),
            stolen=100 * cpu["steal"] / max(cpu["all"], 1),
        )

    def _late(self, gap: int) -> float:
        return gap / 1e6 - 1000 * self._period


def processor_times(since: Mapping[str, int] | None = None) -> dict[str, int]:
    """Read /proc/stat, in ticks: what was stolen, and all there was."""
    first = Path("/proc/stat").read_text(encoding="ascii").splitlines()[0]
    ticks = [int(each) for each in first.split()[1:9]]
    found = {"steal": ticks[7], "all": sum(ticks)}
    return {name: value - since[name] for name, value in found.items()} if since else found


def run_once(folder: Path, rate: float, seconds: float) -> dict[str, Part]:
    """Bring the system up and change it there and back."""
    before = correspondence.nodes(rate)
    after = correspondence.changed(before, rate)
    parameter = {number: dict(node) for number, node in after.items()}
    place = correspondence.CHANGED_PARAMETER
    parameter[place]["parameters"] = {**parameter[place]["parameters"], "note": "again"}
    files = {}
    for name, found in (("before", before), ("after", after), ("parameter", parameter)):
        files[name] = folder / f"{name}.yaml"
        files[name].write_text(json.dumps(correspondence.system(found)), encoding="utf-8")
    with correspondence.figures() as figures:
        ENVIRONMENT.update(figures.environment)
        with a_system.running(files["before"], folder / "logs", len(before)):
            session = (folder / "logs" / "latest").resolve()

            def idle() -> float:
                time.sleep(seconds)
                return seconds

            def apply(target: str) -> float:
                began = time.monotonic()
                subprocess.run(
                    [COMMAND, "apply", files[target], "--session", session],
                    check=True,
                    stdout=subprocess.DEVNULL,
                    env=ENVIRONMENT,
                )
                took = time.monotonic() - began
                time.sleep(AFTER)
                return took

            watch = Watch(figures, 1 / rate)
            watch.settle()
            return {
                "nothing": watch.part(idle),
                "four changes": watch.part(lambda: apply("after")),
                "a parameter": watch.part(lambda: apply("parameter")),
            }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--rate", type=float, default=20.0, help="messages of a node in a second")
    parser.add_argument("--seconds", type=float, default=3.0, help="in which nothing happens")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()

    runs: list[dict[str, Part]] = []
    for _ in range(options.runs):
        with tempfile.TemporaryDirectory(prefix="apply-") as folder:
            runs.append(run_once(Path(folder), options.rate, options.seconds))
    if options.json:
        print(json.dumps([{name: part._asdict() for name, part in run.items()} for run in runs]))
        return
    print(f"{correspondence.NODES} nodes at {options.rate:g} Hz, {options.runs} runs")
    print(header())
    for name in runs[0]:
        parts = [run[name] for run in runs]
        if name != "nothing":
            print(row(f"{name}: apply", [part.seconds for part in parts], "s"))
        print(row(f"{name}: latest message heard", [part.late_heard for part in parts], "ms"))
        print(row(f"{name}: latest message said", [part.late_said for part in parts], "ms"))
        print(row(f"{name}: load, for each processor", [part.load for part in parts], ""))
        print(row(f"{name}: stolen by the host", [part.stolen for part in parts], "%"))
        lost = sum(part.missing + part.began_anew for part in parts)
        late = sum(part.late_heard > GOAL for part in parts)
        print(f"{name}: {lost} lost messages; {late} runs later than {GOAL:g} ms\n")


if __name__ == "__main__":
    main()
