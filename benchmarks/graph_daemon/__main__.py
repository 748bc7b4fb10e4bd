"""The graph daemon under a crowd of nodes, beside ros2cli's own where that can be imported.

    python -m benchmarks.graph_daemon [--small] [--storms N] [--json FILE]

Everything happens in a network namespace of its own, so root is needed (or user namespaces), and
iproute2. ros2cli is found by PYTHONPATH or where it is installed; without it only our daemon is
measured. In full: 61 processes with 115 nodes, about 20 minutes; small: 8 with 16, about 2.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.graph_daemon import measures, report
from benchmarks.graph_daemon.crowd import ATTEMPTS, Crowd
from benchmarks.graph_daemon.daemons import OURS, STOCK, Daemon, ros2cli_is_here
from benchmarks.graph_daemon.measures import Figures, Size
from benchmarks.machine import machine
from benchmarks.own_network import enter_namespace, is_inside
from play_launch.graph_daemon.contract import daemon_address

FULL = Size(
    processes=61,
    nodes=115,
    topics=6,
    calls=300,
    load_seconds=4.0,
    burst_rounds=8,
    wait_limit=70.0,
)
SMALL = Size(
    processes=8,
    nodes=16,
    topics=6,
    calls=50,
    load_seconds=1.0,
    burst_rounds=3,
    wait_limit=20.0,
)


def measure(daemon: Daemon, stock: Daemon | None, size: Size, storms: int) -> Figures:
    """Measure one daemon."""
    address = daemon_address()
    figures: Figures = {}
    report_progress(f"{daemon.name}: a crowd of {size.processes} processes with {size.nodes} nodes")
    with risen_crowd(size) as crowd:
        steps: list[Callable[[], Figures]] = [
            lambda: measures.late_join(daemon, address, crowd.names, size),
            lambda: measures.at_rest(address, size),
            lambda: {"node list": measures.command_time(daemon)},
            lambda: measures.beside_a_silent_client(address, size),
        ]
        for step in steps:
            found = step()
            report_progress(f"{daemon.name}: measured {', '.join(found)}")
            figures |= found
        # A daemon that hangs on the silent client hangs no more, and goes on with a full graph.
        measures.warm(address, crowd.names, size.wait_limit)
        figures |= measures.address_change(address, crowd.names, size)
        figures |= measures.stop_and_stock_start(daemon, stock, address, size)
    return figures | measure_storms(daemon, size, storms)


@contextlib.contextmanager
def risen_crowd(size: Size) -> Iterator[Crowd]:
    """All nodes are there while the block runs."""
    for _ in range(ATTEMPTS):
        with Crowd(size.processes, size.nodes, size.topics) as crowd:
            crowd.start()
            if crowd.wait():
                yield crowd
                return
        report_progress("the crowd did not come up; again")
    raise SystemExit(f"the crowd did not come up in {ATTEMPTS} attempts")


def measure_storms(daemon: Daemon, size: Size, storms: int) -> Figures:
    """Let the crowd start again and again; counts are of all storms, times those of the worst."""
    address = daemon_address()
    seen: list[Figures] = []
    repeated = 0
    while len(seen) < storms:
        report_progress(f"{daemon.name}: storm {len(seen) + 1} of {storms}")
        daemon.start()
        found = measures.storm(address, size)
        daemon.stop()
        if found is not None:
            seen.append(found)
        elif repeated < ATTEMPTS:
            repeated += 1
            report_progress("the crowd did not come up; again")
        else:
            raise SystemExit(f"the crowd did not come up in {1 + repeated} storms")
    figures = {
        name: (sum if report.is_count(name) else max)(one[name] for one in seen) for name in seen[0]
    }
    return figures | {"storm, repeated": repeated}


def report_progress(what: str) -> None:
    print(what, file=sys.stderr, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--storms", type=int, default=0, help="default: 3, small: 1")
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    if not is_inside():
        enter_namespace("benchmarks.graph_daemon")
    size = SMALL if arguments.small else FULL
    storms = arguments.storms or (1 if arguments.small else 3)
    stock = STOCK if ros2cli_is_here() else None
    if stock is None:
        report_progress("ros2cli cannot be imported here: its daemon is not measured")
    subjects: dict[str, Figures] = {}
    with tempfile.TemporaryDirectory() as logs:
        os.environ["ROS_LOG_DIR"] = logs
        try:
            if stock is not None:
                subjects[stock.name] = measure(stock, stock, size, storms)
            subjects[OURS.name] = measure(OURS, stock, size, storms)
        finally:
            # It ends either of them.
            OURS.stop()
    title = f"{size.nodes} nodes in {size.processes} processes, {os.cpu_count()} CPUs"
    print("\n".join([title, report.table(subjects), ""]))
    for goal in report.goals(subjects):
        print(goal.line)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(plain(title, storms, subjects), indent=2) + "\n")


def plain(title: str, storms: int, subjects: report.Subjects) -> dict[str, Any]:
    """What --json writes."""
    return {
        "benchmark": "graph_daemon",
        "machine": machine(),
        "title": title,
        "storms": storms,
        "subjects": report.to_json(subjects),
    }


if __name__ == "__main__":
    main()
