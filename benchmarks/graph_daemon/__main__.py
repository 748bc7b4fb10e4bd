"""The graph daemon under a crowd of nodes, beside ros2cli's own where that can be imported.

    python -m benchmarks.graph_daemon [--small] [--json FILE] [--plot FILE]

Everything happens in a network namespace of its own, so root is needed (or user namespaces), and
iproute2. ros2cli is found by PYTHONPATH or where it is installed; without it only our daemon is
measured. In full: 61 processes with 115 nodes, about 10 minutes; small: 8 with 16, about 2.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.graph_daemon import measures
from benchmarks.graph_daemon.chart import chart
from benchmarks.graph_daemon.crowd import ATTEMPTS, Crowd
from benchmarks.graph_daemon.daemons import OURS, STOCK, Daemon, ros2cli_is_here
from benchmarks.graph_daemon.measures import Figures, Size
from play_launch.graph_daemon.address import daemon_address

FULL = Size(
    processes=61,
    nodes=115,
    topics=6,
    calls=300,
    load_seconds=4.0,
    burst_rounds=8,
    patience=70.0,
)
SMALL = Size(
    processes=8,
    nodes=16,
    topics=6,
    calls=50,
    load_seconds=1.0,
    burst_rounds=3,
    patience=20.0,
)
TARGETS: tuple[tuple[str, float, bool], ...] = (
    ("burst of 32, p99", 20.0, False),
    ("storm, p99 of bursts of 16", 5.0, False),
    ("one client, median", 5.0, False),
    ("8 clients, calls per second", 4.0, True),
    ("late join, all nodes after", 1 / 0.7, False),
    ("storm, nodes seen late", 3.0, False),
    ("node list", 4.0, False),
)
"""Row, by how much ours is to be better than ros2cli's, and whether more is better."""
_INSIDE = "PLAY_LAUNCH_BENCHMARK_INSIDE"
_PREPARE = (
    "mount -t tmpfs none /dev/shm && ip link set lo up multicast on && "
    'ip route add 224.0.0.0/4 dev lo && exec "$@"'
)


def enter_namespace() -> None:
    """Run this program again in a network and mount namespace of its own."""
    for program in ("unshare", "ip"):
        if shutil.which(program) is None:
            raise SystemExit(f"{program} is not installed (packages util-linux and iproute2)")
    flags = ["-n", "-m"] if os.geteuid() == 0 else ["-r", "-n", "-m"]
    again = [sys.executable, "-m", "benchmarks.graph_daemon", *sys.argv[1:]]
    command = ["unshare", *flags, "sh", "-c", _PREPARE, "sh", *again]
    environment = {**os.environ, _INSIDE: "1", "ROS_DOMAIN_ID": "7"}
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS"):
        # LOCALHOST finds at most 32 participants.
        environment.pop(name, None)
    raise SystemExit(subprocess.run(command, check=False, env=environment).returncode)


def measure(daemon: Daemon, stock: Daemon | None, size: Size, storms: int) -> Figures:
    """Measure one daemon."""
    address = daemon_address()
    figures: Figures = {}
    tell(f"{daemon.name}: a crowd of {size.processes} processes with {size.nodes} nodes")
    with risen_crowd(size) as crowd:
        steps: list[Callable[[], Figures]] = [
            lambda: measures.late_join(daemon, address, crowd.names, size),
            lambda: measures.at_rest(address, size),
            lambda: {"node list": measures.command_time(daemon)},
            lambda: measures.beside_a_silent_client(address, size),
        ]
        for step in steps:
            found = step()
            tell(f"{daemon.name}: measured {', '.join(found)}")
            figures |= found
        # A daemon that hangs on the silent client hangs no more, and goes on with a full graph.
        measures.warm(address, crowd.names, size.patience)
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
        tell("the crowd did not come up; again")
    raise SystemExit(f"the crowd did not come up in {ATTEMPTS} attempts")


def measure_storms(daemon: Daemon, size: Size, storms: int) -> Figures:
    """Let the crowd start again and again; counts are of all storms, times those of the worst."""
    address = daemon_address()
    seen: list[Figures] = []
    repeated = 0
    while len(seen) < storms:
        tell(f"{daemon.name}: storm {len(seen) + 1} of {storms}")
        daemon.start()
        found = measures.storm(address, size)
        daemon.stop()
        if found is not None:
            seen.append(found)
        elif repeated < ATTEMPTS:
            repeated += 1
            tell("the crowd did not come up; again")
        else:
            raise SystemExit(f"the crowd did not come up in {1 + repeated} storms")
    figures = {
        name: (sum if is_count(name) else max)(one[name] for one in seen) for name in seen[0]
    }
    return figures | {"storm, repeated": repeated}


def is_count(name: str) -> bool:
    return name.endswith(("failed", "fewest nodes", "seen late", "at first", "repeated"))


def tell(what: str) -> None:
    print(what, file=sys.stderr, flush=True)


def table(subjects: dict[str, Figures]) -> list[str]:
    names = list(dict.fromkeys(name for figures in subjects.values() for name in figures))
    lines = [f"{'':<36}" + "".join(f"{subject:>16}" for subject in subjects)]
    for name in names:
        cells = [written(name, figures.get(name)) for figures in subjects.values()]
        lines.append(f"{name:<36}" + "".join(f"{cell:>16}" for cell in cells))
    return lines


def written(name: str, value: float | None) -> str:
    if value is None:
        return "-"
    if is_count(name):
        return "none seen" if math.isinf(value) else f"{value:.0f}"
    if "per second" in name:
        return f"{value:.0f}"
    return "never" if math.isinf(value) else f"{value * 1e3:.2f} ms"


def verdicts(ours: Figures, stock: Figures) -> list[str]:
    """Compare with the targets."""
    lines = []
    for name, factor, more_is_better in TARGETS:
        if name not in ours or name not in stock:
            continue
        better, worse = (ours[name], stock[name]) if more_is_better else (stock[name], ours[name])
        found = better / worse if worse else math.inf
        lines.append(f"{name}: {found:.1f} x, wanted {factor:.1f} x{_verdict(found >= factor)}")
    for name in ("32 clients, failed", "burst of 32, failed", "storm, failed"):
        failed = ours[name]
        lines += [f"{name}: {failed:.0f}, wanted 0{_verdict(not failed)}"]
    silent = ours["beside a silent client, longest"]
    lines.append(f"beside a silent client: {silent * 1e3:.1f} ms of 100{_verdict(silent < 0.1)}")
    again = ours["after stop, stock start"]
    lines.append(f"after stop, stock start: {again:.2f} s of 2{_verdict(again < 2.0)}")
    short = ours["address change, too few for"]
    lines.append(f"address change: too few nodes for {short:.2f} s{_verdict(not short)}")
    return lines


def _verdict(reached: bool) -> str:
    return "" if reached else "  <- missed"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--storms", type=int, default=0, help="default: 3, small: 1")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    if _INSIDE not in os.environ:
        enter_namespace()
    size = SMALL if arguments.small else FULL
    storms = arguments.storms or (1 if arguments.small else 3)
    stock = STOCK if ros2cli_is_here() else None
    if stock is None:
        tell("ros2cli cannot be imported here: its daemon is not measured")
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
    cpus = os.cpu_count()
    title = f"{size.nodes} nodes in {size.processes} processes, {cpus} CPUs"
    print("\n".join([title, *table(subjects)]))
    if stock is not None:
        print("\n".join(["", *verdicts(subjects[OURS.name], subjects[stock.name])]))
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(plain(title, storms, subjects), indent=2) + "\n")
    if arguments.plot is not None:
        rows = [
            "one client, median",
            "32 clients, p99",
            "burst of 32, p99",
            "beside a silent client, longest",
            "storm, p99 of bursts of 16",
            "late join, all nodes after",
            "after stop, stock start",
            "node list",
        ]
        arguments.plot.write_text(chart(f"Graph daemon: {title}", rows, subjects))


def plain(title: str, storms: int, subjects: dict[str, Figures]) -> dict[str, Any]:
    """JSON knows no infinity: what never came is null."""
    return {
        "title": title,
        "storms": storms,
        "subjects": {
            subject: {name: None if math.isinf(value) else value for name, value in figures.items()}
            for subject, figures in subjects.items()
        },
    }


if __name__ == "__main__":
    main()
