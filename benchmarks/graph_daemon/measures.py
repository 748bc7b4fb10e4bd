"""Measurements of a daemon; all times in seconds."""

from __future__ import annotations

import contextlib
import os
import socket
import statistics
import subprocess
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass

from benchmarks.graph_daemon.crowd import Crowd
from benchmarks.graph_daemon.daemons import Daemon
from benchmarks.graph_daemon.load import NODES, TOPICS, bursts, call_all, nodes
from play_launch.graph_daemon.contract import DaemonAddress

Figures = dict[str, float]
LATE = 1.0
"""A node that is seen later than this after it was made is a late one."""


@dataclass(frozen=True)
class Size:
    """How big a run is."""

    processes: int
    nodes: int
    topics: int
    calls: int
    load_seconds: float
    burst_rounds: int
    wait_limit: float
    """How long to wait for something that may never come."""


def warm(address: DaemonAddress, names: set[str], wait_limit: float) -> float:
    """Wait until all nodes are in one answer; returns how long it took, infinity for never."""
    began = time.monotonic()
    while time.monotonic() - began < wait_limit:
        with contextlib.suppress(OSError):
            if nodes(address) >= names:
                return time.monotonic() - began
        time.sleep(0.02)
    return float("inf")


def at_rest(address: DaemonAddress, size: Size) -> Figures:
    """Answers while nothing changes."""
    call_all(address, TOPICS, at_once=1, calls=10)
    one = call_all(address, TOPICS, at_once=1, calls=size.calls)
    eight = call_all(address, TOPICS, at_once=8, seconds=size.load_seconds)
    many = call_all(address, TOPICS, at_once=32, seconds=size.load_seconds)
    burst = bursts(address, TOPICS, clients=32, rounds=size.burst_rounds)
    return {
        "one client, median": one.median,
        "8 clients, calls per second": eight.rate,
        "32 clients, calls per second": many.rate,
        "32 clients, p99": many.quantile(0.99),
        "32 clients, failed": many.failures,
        "burst of 32, p99": burst.quantile(0.99),
        "burst of 32, failed": burst.failures,
    }


def beside_a_silent_client(address: DaemonAddress, size: Size) -> Figures:
    """The longest of ten calls while one client has connected and sends nothing."""
    with socket.create_connection((address.host, address.port)):
        result = call_all(address, NODES, at_once=1, calls=10, limit=size.wait_limit / 10)
    longest = max(result.latencies, default=float("inf")) if not result.failures else float("inf")
    return {"beside a silent client, longest": longest}


def late_join(daemon: Daemon, address: DaemonAddress, names: set[str], size: Size) -> Figures:
    """From the start of the daemon to an answer with all nodes, while the crowd stands."""
    began = time.monotonic()
    daemon.start()
    # An answer that is not complete is worse than a late one.
    missing = len(names - nodes(address))
    seen = warm(address, names, size.wait_limit)
    return {
        "late join, all nodes after": time.monotonic() - began if seen < size.wait_limit else seen,
        "late join, nodes missing at first": missing,
    }


def address_change(address: DaemonAddress, names: set[str], size: Size) -> Figures:
    """The fewest nodes that an answer has after an address came, and for how long."""
    before = len(nodes(address) & names)
    # Of the loopback interface: not every kernel has dummy ones.
    change = ["dev", "lo"]
    subprocess.run(["ip", "addr", "add", "10.99.0.1/24", *change], check=True)
    fewest, short = before, 0.0
    began = last = time.monotonic()
    try:
        while time.monotonic() - began < size.wait_limit / 2:
            with contextlib.suppress(OSError):
                now = len(nodes(address) & names)
                fewest = min(fewest, now)
                if now < before:
                    short += time.monotonic() - last
            last = time.monotonic()
            time.sleep(0.05)
    finally:
        subprocess.run(["ip", "addr", "del", "10.99.0.1/24", *change], check=True)
    return {"address change, fewest nodes": fewest, "address change, too few for": short}


def storm(address: DaemonAddress, size: Size) -> Figures | None:
    """Bursts of 16 clients while the crowd starts, and how late its nodes are seen.

    None when the crowd did not come up, which no daemon can help: see `Crowd.wait`.
    """
    latencies: list[float] = []
    failures = 0
    seen: dict[str, float] = {}
    over = threading.Event()

    def watch() -> None:
        while not over.is_set():
            with contextlib.suppress(OSError):
                now = time.time()
                for name in nodes(address, 5.0):
                    seen.setdefault(name, now)
            time.sleep(0.05)

    with _ahead_of_the_crowd(), Crowd(size.processes, size.nodes, size.topics) as crowd:
        # They hold the interpreter's lock now and then, so none of them may be kept from running.
        watching = threading.Thread(target=_ahead_of_the_crowd()(watch))
        waiting = threading.Thread(target=_ahead_of_the_crowd()(crowd.wait))
        crowd.start()
        watching.start()
        waiting.start()
        while waiting.is_alive():
            one = bursts(address, TOPICS, clients=16, rounds=1, limit=5.0)
            latencies += one.latencies
            failures += one.failures
            time.sleep(0.1)
        deadline = time.monotonic() + (size.wait_limit if crowd.made.keys() == crowd.names else 0.0)
        while not crowd.names <= seen.keys() and time.monotonic() < deadline:
            time.sleep(0.05)
        over.set()
        watching.join()
        if crowd.made.keys() != crowd.names:
            return None
        delays = [seen.get(name, float("inf")) - made for name, made in crowd.made.items()]
    latencies.sort()
    return {
        "storm, p99 of bursts of 16": latencies[int(0.99 * len(latencies))],
        "storm, failed": failures,
        "storm, nodes seen late": sum(delay > LATE for delay in delays),
        "storm, median delay of a node": statistics.median(delays),
    }


@contextlib.contextmanager
def _ahead_of_the_crowd() -> Iterator[None]:
    """Have this thread run when it wants to: a client's wait for a processor is no answer time.

    Needs CAP_SYS_NICE; without it both daemons' figures have the same wait in them. Threads and
    processes that it starts do not inherit it (SCHED_RESET_ON_FORK).
    """
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


def stop_and_stock_start(
    daemon: Daemon, stock: Daemon | None, address: DaemonAddress, size: Size
) -> Figures:
    """From the end of ``stop``, after a hammering, until ros2cli's daemon can start."""
    call_all(address, NODES, at_once=8, calls=200)
    daemon.stop()
    began = time.monotonic()
    while time.monotonic() - began < size.wait_limit:
        if stock is None:
            with socket.socket() as like_stock, contextlib.suppress(OSError):
                like_stock.bind((address.host, address.port))
                break
        elif "started" in stock.run("daemon", "start")[1]:
            break
        time.sleep(0.1)
    else:
        return {"after stop, stock start": float("inf")}
    took = time.monotonic() - began
    if stock is not None:
        stock.stop()
    return {"after stop, stock start": took}


def command_time(command: Daemon, runs: int = 7) -> float:
    """Median of ``node list``."""
    return statistics.median(command.run("node", "list")[0] for _ in range(runs))
