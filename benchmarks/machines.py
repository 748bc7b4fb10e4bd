"""Three hosts of 50 composable nodes each, beside the same without a coordinator; `ps`; cuts.

    python -m benchmarks.machines [--runs N] [--cuts N] [--seconds S] [--containers N] [--json]

The hosts are network namespaces of this machine and share its CPUs. So their bring-up as one system
is measured beside three supervisors that are started by hand at the same moment, which have the
same work and the same discovery, as well as beside one host alone. Needs root. On the host that is
cut, a process counts and another ends again and again: all its lines and starts have to arrive.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.sampling import cpu_seconds
from benchmarks.statistics import header, row
from play_launch.deploy.machines.namespaces import missing
from tests.support.hosts import Hosts, Running
from tests.support.waiting import until

HOSTS, NODES = 3, 10
LOST_AFTER = 2
"""Seconds without an answer until a host is lost."""
AT_REST = 0.5
"""Seconds of CPU that all processes of the hosts take in one: discovery is over."""
PROGRAM = Path(sys.executable).with_name("play-launch")


def configuration(of: Sequence[int], containers: int, *, by_machines: bool) -> str:
    node = {"package": "play_launch_demo", "plugin": "play_launch_demo::Listener"}
    found: list[dict[str, Any]] = [
        {
            "name": f"c{host}_{container}",
            "container_type": "isolated",
            "composable_nodes": [
                {**node, "name": f"n{host}_{container}_{number}"} for number in range(NODES)
            ],
            **({"machine": f"h{host}"} if by_machines else {}),
        }
        for host in of
        for container in range(containers)
    ]
    ticks = "i=0; while :; do echo tick $((i += 1)); read -t 0.2 <> <(:); done"
    ends = {
        "on_exit": "restart",
        "restart": {"max_restarts": 100, "within": "1 s", "backoff": {"maximum": "200 ms"}},
    }
    machine = {
        "service": "none",
        "play_launch": str(PROGRAM),
        "lost_after": f"{LOST_AFTER} s",
    }
    values: dict[str, Any] = {
        "version": 1,
        "name": "several" if by_machines else f"apart{of[0]}",
        "environment": {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_DOMAIN_ID": "7"},
        "record": {"sampling": {"period": "never"}},
        "containers": found,
    }
    if by_machines:
        values["machines"] = {f"h{host}": machine for host in of}
        values["nodes"] = [
            {"name": "ticks", "machine": f"h{HOSTS}", "command": ["bash", "-c", ticks]},
            {"name": "ends", "machine": f"h{HOSTS}", "command": ["sleep", "0.3"], **ends},
        ]
    return json.dumps(values)


def usage(pid: int) -> tuple[float, int]:
    """Seconds of CPU and kB of memory of a process."""
    memory = Path(f"/proc/{pid}/status").read_text().split("VmRSS:")[1].split()[0]
    return cpu_seconds(pid), int(memory)


def started(net: Hosts, stem: str, contents: dict[int, str]) -> tuple[list[Running], float]:
    """Start systems, by host; return them and the seconds until all is loaded."""
    configs = {host: net.folder / f"{stem}_{host}.yaml" for host in contents}
    for host, content in contents.items():
        configs[host].write_text(content)
    began = time.monotonic()
    systems = [Running(net, config, host) for host, config in configs.items()]
    for system in systems:
        system.loaded()
    return systems, time.monotonic() - began


def measure(runs: int, cuts: int, cut: float, containers: int) -> dict[str, Any]:
    found: dict[str, Any] = {"ticks": [0, 0], "starts": [0, 0]}
    found |= {key: [] for key in ("alone_s", "apart_s", "three_s", "ps_s", "ps_at_rest_s")}
    hosts = range(1, HOSTS + 1)
    apart = {host: configuration([host], containers, by_machines=False) for host in hosts}
    with tempfile.TemporaryDirectory(prefix="machines-") as name, Hosts(Path(name), HOSTS) as net:
        for number in range(runs):
            for key, contents in (("alone_s", {HOSTS: apart[HOSTS]}), ("apart_s", apart)):
                systems, seconds = started(net, f"{key}{number}", contents)
                found[key].append(seconds)
                for system in systems:
                    system.stop()
            content = configuration(hosts, containers, by_machines=True)
            [three], seconds = started(net, f"three{number}", {1: content})
            found["three_s"].append(seconds)
            _ask(three, HOSTS * containers * (NODES + 1) + 2, found["ps_s"])
            until(lambda: _cpu(net, 1.0) < AT_REST, "rest")
            _ask(three, HOSTS * containers * (NODES + 1) + 2, found["ps_at_rest_s"])
            if number == runs - 1:
                _cut(net, three, cuts, cut, found)
            three.stop()
            _count(three.ticks(), 1, found["ticks"])
            starts = [
                each["restarts"]
                for each in three.events()
                if each["event"] == "process" and each["name"] == "/ends"
                if each["kind"] == "started"
            ]
            _count(starts, 0, found["starts"])
    return found


def _count(numbers: list[int], first: int, found: list[int]) -> None:
    """Add how many numbers there are, and how many are not there, or not once."""
    found[0] += len(numbers)
    wrong = set(range(first, max(numbers) + 1)) ^ set(numbers)
    found[1] += len(wrong) + len(numbers) - len(set(numbers))


def _cpu(net: Hosts, seconds: float) -> float:
    """Seconds of CPU that the processes of the hosts take meanwhile."""

    def used() -> dict[int, float]:
        found = {}
        for pid in (pid for host in range(1, HOSTS + 1) for pid in net.pids(host)):
            with contextlib.suppress(OSError):  # it has ended meanwhile
                found[pid] = cpu_seconds(pid)
        return found

    before = used()
    time.sleep(seconds)
    return sum(now - before.get(pid, 0.0) for pid, now in used().items())


def _ask(system: Running, count: int, seconds: list[float]) -> None:
    for _ in range(5):
        began = time.monotonic()
        rows = system.rows()
        seconds.append(time.monotonic() - began)
        if len(rows) != count:
            raise SystemExit(f"ps lists {len(rows)} rows, not {count}")


def _cut(net: Hosts, system: Running, cuts: int, cut: float, found: dict[str, Any]) -> None:
    before = usage(system.process.pid)
    for _ in range(cuts):
        net.set_link(HOSTS, "down")
        time.sleep(cut)
        net.set_link(HOSTS, "up")
        until(lambda: '"running"' in system.ask("ps", "--json", "ticks"), "its return")
    after = usage(system.process.pid)
    found["cpu_s_of_a_cut"] = (after[0] - before[0]) / max(cuts, 1)
    found["memory_kb"] = [before[1], after[1]]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--cuts", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=LOST_AFTER + 1, help="of a cut")
    parser.add_argument("--containers", type=int, default=5, help="of 10 nodes, on each host")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if problem := missing():
        raise SystemExit(problem)
    found = measure(options.runs, options.cuts, options.seconds, options.containers)
    if options.json:
        print(json.dumps(found))
        return
    nodes = HOSTS * options.containers * NODES
    print(f"{nodes} nodes on {HOSTS} hosts, {os.cpu_count()} CPUs for all")
    print(header())
    for name, key in (
        ("one alone", "alone_s"),
        ("three apart", "apart_s"),
        ("all three", "three_s"),
        ("ps at once", "ps_s"),
        ("ps at rest", "ps_at_rest_s"),
    ):
        print(row(name, [1000 * each for each in found[key]], "ms"))
    alone, apart, three = (
        statistics.median(found[f"{key}_s"]) for key in ("alone", "apart", "three")
    )
    print(f"all three: {three / apart:.2f} x apart, {three / alone:.1f} x one alone")
    for key, what in (("ticks", "lines"), ("starts", "starts of a process")):
        print(f"{found[key][0]} {what} arrived, {found[key][1]} lost or doubled")
    begin, end = found["memory_kb"]
    print(f"{options.cuts} cuts: {found['cpu_s_of_a_cut']:.2f} s of CPU each, {begin} to {end} kB")


if __name__ == "__main__":
    main()
