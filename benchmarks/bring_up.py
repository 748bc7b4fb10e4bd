"""Bring-up of 15 containers with 54 nodes, beside the bare cost of the same processes and nodes.

The bare cost is that of 15 programs started at once, each with one DDS participant and its share of
the 54 components, constructed one after the other: no supervisor, no services, no events. What the
command takes longer is the price of supervising.

    python -m benchmarks.bring_up [--runs N] [--containers N] [--nodes N] [--consolidate] [--json]

With ``--consolidate``, the same configuration runs besides with all containers in one process.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.statistics import header, row

PREFIX = Path(sys.prefix)
COMMAND = PREFIX / "bin" / "play-launch"
BARE = PREFIX / "lib" / "play_launch_demo" / "bare_container"
LIBRARY = PREFIX / "lib" / "libplay_launch_demo.so"
PLUGIN = "play_launch_demo::Talker"
ENVIRONMENT = {
    **os.environ,
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    "ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID", "97"),
}
# With it, Python would compile every module of ours in each run, which no installation does.
ENVIRONMENT.pop("PYTHONDONTWRITEBYTECODE", None)
# LOCALHOST finds at most 32 participants.
MOST_CONTAINERS = 30
TIMEOUT = 120.0


def shares(nodes: int, containers: int) -> list[int]:
    """Spread the nodes evenly: 54 in 15 gives 4,4,…,3."""
    return [nodes // containers + (i < nodes % containers) for i in range(containers)]


def configuration(nodes: Sequence[int], container_type: str, more: str = "") -> str:
    loading = f"{{container_type: {container_type}{more}}}"
    lines = ["version: 1", f"composable_node_loading: {loading}"]
    lines.append("containers:")
    for c, count in enumerate(nodes):
        lines += [f"  - name: c{c}", "    composable_nodes:"]
        lines += [
            f"      - {{package: play_launch_demo, plugin: '{PLUGIN}', name: c{c}_{n}, "
            "parameters: {rate: 1.0}}"
            for n in range(count)
        ]
    return "\n".join(lines) + "\n"


def cpu_of_children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def supervised(config: Path, logs: Path, nodes: int) -> Mapping[str, float]:
    """Run the command until all nodes are loaded, then stop it."""
    cpu = cpu_of_children()
    start = time.monotonic()
    with subprocess.Popen(
        [COMMAND, "replay", config, "--log-dir", logs, "--json", "--quiet"],
        stdout=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
    ) as process:
        assert process.stdout is not None
        session = first = last = 0.0
        loaded = 0
        for line in process.stdout:
            event: dict[str, Any] = json.loads(line)
            session = session or time.monotonic()
            if event["event"] == "component" and event["kind"] == "loaded":
                loaded += 1
                first = first or time.monotonic()
                last = time.monotonic()
                if loaded == nodes:
                    break
            if time.monotonic() - start > TIMEOUT:
                break
        memory = peak_memory(process.pid)
        stopping = time.monotonic()
        process.terminate()
        process.communicate(timeout=TIMEOUT)
        stopped = time.monotonic()
    if loaded != nodes:
        raise SystemExit(f"only {loaded} of {nodes} nodes were loaded")
    return {
        "wall": last - start,
        "wall_without_start": last - session,
        "cpu": cpu_of_children() - cpu,
        "stop": stopped - stopping,
        "memory": memory,
    }


def peak_memory(pid: int) -> float:
    """Peak resident memory in MB, from VmHWM in /proc."""
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1000
    return 0.0


def bare(nodes: Sequence[int]) -> Mapping[str, float]:
    """Start the bare programs at once and wait until each says that it is ready."""
    cpu = cpu_of_children()
    start = time.monotonic()
    processes = [
        subprocess.Popen(
            [BARE, LIBRARY, PLUGIN, f"b{c}_", str(count), "--ros-args", "-p", "rate:=1.0"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=ENVIRONMENT,
        )
        for c, count in enumerate(nodes)
    ]
    for process in processes:
        assert process.stdout is not None
        if process.stdout.readline() != b"ready\n":
            raise SystemExit("a bare container did not come up")
    wall = time.monotonic() - start
    for process in processes:
        process.communicate(timeout=TIMEOUT)
    return {"wall": wall, "cpu": cpu_of_children() - cpu}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--containers", type=int, default=15)
    parser.add_argument("--nodes", type=int, default=54)
    parser.add_argument("--type", dest="container_type", default="standard")
    parser.add_argument("--consolidate", action="store_true")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    if not 1 <= arguments.containers <= MOST_CONTAINERS:
        parser.error(f"--containers: 1 to {MOST_CONTAINERS}")
    nodes = shares(arguments.nodes, arguments.containers)
    results: dict[str, list[Mapping[str, float]]]
    results = {"supervised": [], "bare": [], "consolidated": []}
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "bring_up.yaml"
        config.write_text(configuration(nodes, arguments.container_type), encoding="utf-8")
        one = Path(folder) / "consolidated.yaml"
        text = configuration(nodes, arguments.container_type, ", consolidate: true")
        one.write_text(text, encoding="utf-8")
        supervised(config, Path(folder) / "warm-up", arguments.nodes)
        bare(nodes)
        for run in range(arguments.runs):
            print(f"run {run + 1} of {arguments.runs}", file=sys.stderr)
            # In turn, so that a change in the machine's speed meets both.
            results["supervised"].append(
                supervised(config, Path(folder) / f"logs{run}", arguments.nodes)
            )
            results["bare"].append(bare(nodes))
            if arguments.consolidate:
                logs = Path(folder) / f"one{run}"
                results["consolidated"].append(supervised(one, logs, arguments.nodes))
    if arguments.json:
        print(json.dumps(results))
        return
    with_us, without = results["supervised"], results["bare"]
    print(
        f"{arguments.nodes} nodes in {arguments.containers} containers, "
        f"{arguments.container_type}, {os.cpu_count()} CPUs, {arguments.runs} runs"
    )
    print(header())
    print(row("command to last node loaded", [r["wall"] for r in with_us], "s"))
    print(row("  without starting Python", [r["wall_without_start"] for r in with_us], "s"))
    print(row("bare cost", [r["wall"] for r in without], "s"))
    ratios = [a["wall"] / b["wall"] for a, b in zip(with_us, without, strict=True)]
    print(row("command / bare cost, pair by pair", ratios, "x"))
    print(row("CPU of the whole tree, stop included", [r["cpu"] for r in with_us], "s"))
    print(row("CPU of the bare programs", [r["cpu"] for r in without], "s"))
    print(row("supervisor's peak memory", [r["memory"] for r in with_us], "MB"))
    print(row("SIGTERM to everything gone", [r["stop"] for r in with_us], "s"))
    if one_process := results["consolidated"]:
        print(row("consolidated: command to last node", [r["wall"] for r in one_process], "s"))
        print(row("  CPU of the whole tree", [r["cpu"] for r in one_process], "s"))
        print(row("  SIGTERM to everything gone", [r["stop"] for r in one_process], "s"))


if __name__ == "__main__":
    main()
