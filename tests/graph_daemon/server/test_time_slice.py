"""The daemon asks for short turns, and for nothing else."""

from __future__ import annotations

import platform
import subprocess
import sys

ASKING = """
import os
from pathlib import Path
from threading import Thread
from play_launch.graph_daemon.server.time_slice import ask_for_short_turns

nice = os.getpriority(os.PRIO_PROCESS, 0)
os.nice(3)
taken = ask_for_short_turns()
def show():
    print(taken, os.getpriority(os.PRIO_PROCESS, 0) - nice, os.sched_getscheduler(0), *[
        line.split()[-1] for line in Path("/proc/thread-self/sched").read_text().splitlines()
        if line.startswith("se.slice")
    ])
thread = Thread(target=show)
thread.start()
thread.join()
"""


def kernel() -> tuple[int, ...]:
    return tuple(int(part) for part in platform.release().split("-")[0].split(".")[:2])


def test_a_thread_and_those_it_starts_get_them() -> None:
    command = [sys.executable, "-c", ASKING]
    words = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    taken, nice, policy, *slices = words
    assert (nice, policy) == ("3", "0")
    if kernel() >= (6, 12):
        assert taken == "True"
    # Kernels without the scheduler's debugging do not show it.
    assert slices in ([], ["100000"]) or kernel() < (6, 12)
