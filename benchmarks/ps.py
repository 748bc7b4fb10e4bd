"""How long commands take on a running session of 15 containers, 54 composables and 46 processes.

    python -m benchmarks.ps [--runs N] [--json]

The system is configs/autoware_scale.yaml, at rest. Times are those of the whole command, from its
start to its end, the start of Python included; `python -c pass` stands beside them. CPU is that of
the command, and of the supervisor in the same time. The first `graph check` starts the daemon.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.bring_up import COMMAND, ENVIRONMENT, cpu_of_children
from benchmarks.running import running
from benchmarks.sampling import cpu_seconds
from benchmarks.statistics import header, row

SAMPLE = Path(__file__).parents[1] / "configs" / "autoware_scale.yaml"
COMPOSABLES, ROWS = 54, 115
SETTLED = 20.0
"""Seconds from the last node to the first command: processes start beside the containers."""
COMMANDS: dict[str, list[str | Path]] = {
    "python -c pass": [sys.executable, "-c", "pass"],
    "ps --json": [COMMAND, "ps", "--json"],
    "ps": [COMMAND, "ps"],
    "ps --json of one": [COMMAND, "ps", "--json", "/sensing/lidar_top/crop_box_self"],
    "events --json": [COMMAND, "events", "--json"],
    "logs": [COMMAND, "logs"],
    "graph check": [COMMAND, "graph", "check"],
}


class Times:
    """Of all runs of one command, in seconds."""

    def __init__(self) -> None:
        self.wall: list[float] = []
        self.command: list[float] = []
        self.supervisor: list[float] = []

    def take(self, command: Sequence[str | Path], supervisor: int, folder: Path) -> None:
        """Run it once more."""
        of_session = command[0] == COMMAND and command != COMMANDS["graph check"]
        whole = [*command, "--session", folder] if of_session else command
        cpu, theirs = cpu_of_children(), cpu_seconds(supervisor)
        began = time.monotonic()
        done = subprocess.run(whole, check=of_session, capture_output=True, env=ENVIRONMENT)
        self.wall.append(time.monotonic() - began)
        self.command.append(cpu_of_children() - cpu)
        self.supervisor.append(cpu_seconds(supervisor) - theirs)
        if command == COMMANDS["ps --json"] and len(json.loads(done.stdout)) != ROWS:
            raise SystemExit(f"ps does not list {ROWS} rows")


def measure(runs: int, settle: float) -> dict[str, Times]:
    """Run all commands in turn, so many times."""
    found = {name: Times() for name in COMMANDS}
    with tempfile.TemporaryDirectory(prefix="ps-") as name:
        logs = Path(name)
        with running(SAMPLE, logs, COMPOSABLES) as run:
            time.sleep(settle)
            for _ in range(runs):
                for command, times in found.items():
                    times.take(COMMANDS[command], run.pid, logs / "latest")
        subprocess.run([COMMAND, "daemon", "stop"], check=False, env=ENVIRONMENT)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--settle", type=float, default=SETTLED, help="seconds before that")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = measure(options.runs, options.settle)
    if options.json:
        print(json.dumps({name: vars(times) for name, times in found.items()}))
        return
    print(f"{ROWS} rows, {os.cpu_count()} CPUs, {options.runs} runs, load {os.getloadavg()[0]:.1f}")
    print(header())
    for name, times in found.items():
        print(row(name, [1000 * each for each in times.wall], "ms"))
        print(row("  CPU of it", [1000 * each for each in times.command], "ms"))
        print(row("  CPU of the supervisor", [1000 * each for each in times.supervisor], "ms"))


if __name__ == "__main__":
    main()
