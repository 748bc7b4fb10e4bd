"""Bring-up of upstream's Talker 54 times in 15 containers, by `ros2 launch` and by play-launch.

Needs rclcpp_components, the package `composition` of the demonstrations, and `ros2 launch`; a
network namespace of its own keeps other ROS systems of the machine out of it:

    unshare -n sh -c 'ip link set lo up && python -m benchmarks.rclcpp_bring_up [--runs N]'

CPU is what the whole tree has used when the last node is told to be loaded. Memory is looked at two
seconds later: RSS counts shared pages once per process, PSS divides them among processes that share
them. Processes of isolated nodes share their container's memory, and are counted with it.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import psutil

from benchmarks.bring_up import COMMAND, ENVIRONMENT, TIMEOUT, shares
from benchmarks.statistics import header, row

PACKAGE, PLUGIN = "composition", "composition::Talker"
SETTLED = 2.0
"""Seconds between the last node and the look at the memory."""

LAUNCH_FILE = """
from launch import LaunchDescription
from launch_ros.actions import ComposableNodeContainer
from launch_ros.descriptions import ComposableNode

SHARES = {shares}


def generate_launch_description():
    return LaunchDescription([
        ComposableNodeContainer(
            name=f"c{{c}}", namespace="", package="rclcpp_components",
            executable="component_container", output="log",
            composable_node_descriptions=[
                ComposableNode(
                    package="{package}", plugin="{plugin}", name=f"c{{c}}_{{n}}",
                    remappings=[("chatter", f"chatter_{{c}}_{{n}}")])
                for n in range(count)])
        for c, count in enumerate(SHARES)])
"""


def configuration(nodes: list[int], container_type: str) -> str:
    """The same in our own format; `consolidated` is isolated in one process."""
    is_one = container_type == "consolidated"
    loading = "isolated, consolidate: true" if is_one else container_type
    lines = ["version: 1", f"composable_node_loading: {{container_type: {loading}}}", "containers:"]
    for c, count in enumerate(nodes):
        lines += [f"  - name: c{c}"]
        if container_type == "stock":
            lines += ["    package: rclcpp_components", "    executable: component_container"]
        lines += ["    composable_nodes:"]
        lines += [
            f"      - {{package: {PACKAGE}, plugin: '{PLUGIN}', name: c{c}_{n}, "
            f"remappings: {{chatter: chatter_{c}_{n}}}}}"
            for n in range(count)
        ]
    return "\n".join(lines) + "\n"


def is_told_by_launch(line: str) -> bool:
    return "Loaded node '" in line


def is_told_by_us(line: str) -> bool:
    event = json.loads(line)
    return bool(event["event"] == "component" and event["kind"] == "loaded")


def tree(pid: int) -> list[psutil.Process]:
    root = psutil.Process(pid)
    return [root, *root.children(recursive=True)]


def cpu_of(processes: list[psutil.Process]) -> float:
    """User and system time in seconds, that of children which ended included."""
    total = 0.0
    for process in processes:
        times = process.cpu_times()
        total += times.user + times.system + times.children_user + times.children_system
    return total


def memory_of(processes: list[psutil.Process]) -> tuple[float, float]:
    """RSS and PSS in MB."""
    containers = {p.pid for p in processes if Path(p.exe()).name == "component_container"}
    own = [p for p in processes if p.pid not in containers or p.ppid() not in containers]
    full = [p.memory_full_info() for p in own]
    return sum(m.rss for m in full) / 1e6, sum(m.pss for m in full) / 1e6


def bring_up(command: list[str], is_told: Callable[[str], bool], nodes: int) -> Mapping[str, float]:
    """Run the command until all nodes are told to be loaded; then measure and stop it."""
    start = time.monotonic()
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=ENVIRONMENT
    ) as process:
        assert process.stdout is not None
        too_late = threading.Timer(TIMEOUT, process.terminate)
        too_late.start()
        loaded = 0
        for line in process.stdout:
            loaded += is_told(line)
            if loaded == nodes:
                break
        too_late.cancel()
        if loaded != nodes:
            raise SystemExit(f"only {loaded} of {nodes} nodes were loaded by: {' '.join(command)}")
        wall = time.monotonic() - start
        processes = tree(process.pid)
        cpu = cpu_of(processes)
        time.sleep(SETTLED)
        rss, pss = memory_of(processes)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=TIMEOUT)
    return {"wall": wall, "cpu": cpu, "rss": rss, "pss": pss}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--containers", type=int, default=15)
    parser.add_argument("--nodes", type=int, default=54)
    parser.add_argument("--types", nargs="*", default=["standard", "isolated", "consolidated"])
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    nodes = shares(arguments.nodes, arguments.containers)
    ros2 = shutil.which("ros2")
    if ros2 is None:
        parser.error("ros2 is not in PATH")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        launch_file = folder / "bring_up_launch.py"
        text = LAUNCH_FILE.format(shares=nodes, package=PACKAGE, plugin=PLUGIN)
        launch_file.write_text(text, encoding="utf-8")
        ways = {"ros2 launch, stock containers": [ros2, "launch", os.fspath(launch_file)]}
        for kind in arguments.types:
            config = folder / f"{kind}.yaml"
            config.write_text(configuration(nodes, kind), encoding="utf-8")
            ways[f"play-launch, {kind}"] = [
                *(os.fspath(COMMAND), "replay", os.fspath(config), "--json", "--quiet"),
                *("--log-dir", os.fspath(folder)),
            ]
        results: dict[str, list[Mapping[str, float]]] = {way: [] for way in ways}
        for run in range(arguments.runs):
            for way, command in ways.items():
                print(f"run {run + 1} of {arguments.runs}: {way}", file=sys.stderr)
                is_told = is_told_by_launch if command[0] == ros2 else is_told_by_us
                results[way].append(bring_up(command, is_told, arguments.nodes))
    if arguments.json:
        print(json.dumps(results))
        return
    print(
        f"{arguments.nodes} nodes in {arguments.containers} containers, {os.cpu_count()} CPUs, "
        f"{arguments.runs} runs"
    )
    print(header())
    for way, figures in results.items():
        print(way)
        print(row("  command to last node loaded", [f["wall"] for f in figures], "s"))
        print(row("  CPU until then", [f["cpu"] for f in figures], "s"))
        print(row("  RSS of all processes", [f["rss"] for f in figures], "MB"))
        print(row("  PSS of all processes", [f["pss"] for f in figures], "MB"))


if __name__ == "__main__":
    main()
