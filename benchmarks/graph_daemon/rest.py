"""What the graph daemon takes of a processor while nothing changes.

    python -m benchmarks.graph_daemon.rest [--repetitions N] [--seconds N]

54 nodes in 15 processes, in a network namespace of its own. Each repetition is a while in which
no client asks, and one with the requests of a replay that records the graph. In full: about
10 minutes.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from benchmarks.graph_daemon.__main__ import report_progress, risen_crowd
from benchmarks.graph_daemon.daemons import OURS
from benchmarks.graph_daemon.measures import Size, warm
from benchmarks.own_network import enter_namespace, is_inside
from play_launch.graph_daemon.contract import STATUS_METHOD, DaemonAddress, daemon_address
from play_launch.graph_daemon.graph_client import GraphClient
from play_launch.graph_daemon.observer import LONGEST_POLL

GOAL = 0.5
"""Per cent of one processor, for the daemon's user and system time together."""
SIZE = Size(
    processes=15,
    nodes=54,
    topics=6,
    calls=0,
    load_seconds=0.0,
    burst_rounds=0,
    wait_limit=60.0,
)


def taken(pid: int) -> Counter[str]:
    """Nanoseconds of processor time by the name of the thread, user and system."""
    times: Counter[str] = Counter()
    for thread in (Path("/proc") / str(pid) / "task").iterdir():
        name = (thread / "comm").read_text().strip()
        times[name] += int((thread / "schedstat").read_text().split()[0])
    return times


def no_client_asks(seconds: float) -> None:
    time.sleep(seconds)


def a_replay_asks(seconds: float) -> None:
    client = GraphClient(daemon_address())
    generation = str(json.loads(str(client.call(STATUS_METHOD)))["generation"])
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        client.call(STATUS_METHOD, generation)
        time.sleep(max(0.0, min(LONGEST_POLL, end - time.monotonic())))


def share(pid: int, seconds: float, meanwhile: Callable[[float], None]) -> dict[str, float]:
    """Per cent of a processor by thread."""
    before, began = taken(pid), time.monotonic()
    meanwhile(seconds)
    spent, took = taken(pid) - before, time.monotonic() - began
    return {name: nanoseconds / took / 1e7 for name, nanoseconds in spent.items()}


def settled(address: DaemonAddress) -> int:
    """Wait until the graph is at rest; returns the daemon's process."""
    client = GraphClient(address)
    while True:
        status = json.loads(str(client.call(STATUS_METHOD)))
        if status["unchanged_for"] > 10.0:
            return int(status["pid"])
        time.sleep(1.0)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--repetitions", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=30.0, help="of each of them")
    arguments = parser.parse_args()
    if not is_inside():
        enter_namespace("benchmarks.graph_daemon.rest")
    kinds = {"no client asks": no_client_asks, "a replay asks": a_replay_asks}
    found: dict[str, list[dict[str, float]]] = {name: [] for name in kinds}
    with tempfile.TemporaryDirectory() as logs:
        os.environ["ROS_LOG_DIR"] = logs
        address = daemon_address()
        OURS.start()
        try:
            with risen_crowd(SIZE) as crowd:
                warm(address, crowd.names, SIZE.wait_limit)
                pid = settled(address)
                for number in range(arguments.repetitions):
                    report_progress(f"repetition {number + 1} of {arguments.repetitions}")
                    for name, kind in kinds.items():
                        found[name].append(share(pid, arguments.seconds, kind))
        finally:
            OURS.stop()
    for name, shares in found.items():
        sums = sorted(sum(one.values()) for one in shares)
        median = statistics.median(sums)
        missed = "" if median < GOAL else "  <- missed"
        print(
            f"{name}: {median:.2f} % of a processor, {sums[0]:.2f} to {sums[-1]:.2f} "
            f"(goal: under {GOAL} %){missed}"
        )
        threads = {thread for one in shares for thread in one}
        for thread in sorted(threads):
            part = statistics.median(one.get(thread, 0.0) for one in shares)
            print(f"    {part:.3f} % {thread}")


if __name__ == "__main__":
    main()
