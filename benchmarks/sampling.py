"""What recording and sampling 54 nodes at rest take: CPU of the supervisor, size of the file.

    python -m benchmarks.sampling [--seconds N] [--runs N] [--containers N] [--nodes N] [--json]

Runs with samples, with samples and a control group for each process, and without alternate. The
CPU time is that of the supervisor, its recorder and its display included, over that many seconds,
which begin some seconds after the last node was loaded.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from benchmarks.bring_up import configuration, shares
from benchmarks.running import running
from benchmarks.statistics import header, row
from play_launch.process.cgroups.group import GroupError
from play_launch.process.cgroups.session_groups import delegated_group

RATE = 0.001
"""Of the talkers, in Hz: they publish nothing while they are measured."""


def cpu_seconds(pid: int) -> float:
    """CPU time of a process since its start, by its clock (``clock_getcpuclockid(3)``)."""
    return time.clock_gettime(~pid << 3 | 2)


def at_rest(
    config: Path, logs: Path, nodes: int, *, settle: float, seconds: float
) -> Mapping[str, float]:
    """Bring the system up, let it come to rest, and measure the supervisor meanwhile."""
    with running(config, logs, nodes) as run:
        time.sleep(settle)
        recording = logs / "latest"
        size, cpu, begin = size_of(recording), cpu_seconds(run.pid), time.monotonic()
        time.sleep(seconds)
        elapsed = time.monotonic() - begin
        cpu, size = cpu_seconds(run.pid) - cpu, size_of(recording) - size
    return {"cpu": 100 * cpu / elapsed, "size": size / elapsed * 3600 / 1e6}


def size_of(folder: Path) -> int:
    """Bytes of all files of a session."""
    return sum(path.stat().st_size for path in folder.iterdir() if path.is_file())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--settle", type=float, default=5.0, help="seconds before that")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--containers", type=int, default=15)
    parser.add_argument("--nodes", type=int, default=54)
    parser.add_argument("--type", default="isolated", help="container_type")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()

    counts = shares(options.nodes, options.containers)
    text, with_groups = (
        configuration(counts, options.type, more).replace("rate: 1.0", f"rate: {RATE}")
        for more in ("", ", cgroups: {enabled: true}")
    )
    ways = {
        "sampled": (text, "1 s"),
        "sampled, with groups": (with_groups, "1 s"),
        "not sampled": (text, "never"),
    }
    try:
        delegated_group()
    except GroupError as error:
        print(f"sampled, with groups: not measured, {error}", file=sys.stderr)
        del ways["sampled, with groups"]
    figures: dict[str, list[Mapping[str, float]]] = {name: [] for name in ways}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(options.runs):
            for index, (name, (system, period)) in enumerate(ways.items()):
                config = Path(folder, f"{index}.yaml")
                config.write_text(f"{system}record: {{sampling: {{period: {period}}}}}\n", "utf-8")
                logs = Path(folder, f"logs-{number}-{index}")
                figures[name].append(
                    at_rest(
                        config,
                        logs,
                        options.nodes,
                        settle=options.settle,
                        seconds=options.seconds,
                    )
                )
    if options.json:
        print(json.dumps(figures))
        return
    print(f"{options.nodes} nodes in {options.containers} containers ({options.type}), at rest")
    print(f"{options.runs} runs of {options.seconds:g} s\n")
    print(header())
    for name, runs in figures.items():
        print(row(f"supervisor, {name}", [run["cpu"] for run in runs], "% of a core"))
    for name, runs in figures.items():
        print(row(f"recording, {name}", [run["size"] for run in runs], "MB/h"))


if __name__ == "__main__":
    main()
