"""The daemon asks for short turns, and for more of them where it may."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from play_launch.process.time_slice import NICE

ASKING = """
import os
from pathlib import Path
from threading import Thread
from play_launch.process.time_slice import ask_for_short_turns

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


STARTING = """
import asyncio, os, sys
from pathlib import Path
from play_launch.process.child import spawn
from play_launch.process.guard import SessionGuard
from play_launch.process.time_slice import ask_for_short_turns

def slice_of(pid):
    lines = Path(f"/proc/{pid}/sched").read_text().splitlines()
    return next((line.split()[-1] for line in lines if line.startswith("se.slice")), "")

async def main():
    ask_for_short_turns()
    guard = SessionGuard.start(Path(sys.argv[1]))
    child = spawn(["sleep", "1000"], env=os.environ, guard=guard)
    print(slice_of(guard.pid), slice_of(child.pid))
    guard.close()

asyncio.run(main())
"""


def test_what_a_guard_starts_has_the_usual_turns(guard: Path) -> None:
    command = [sys.executable, "-c", STARTING, str(guard)]
    words = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout
    # Kernels without the scheduler's debugging do not show it.
    of_guard, of_child = words.split() or ("100000", "")
    assert of_child != "100000"
    assert of_guard == "100000" or kernel() < (6, 12)


PREFERRING = """
import ctypes, os, resource, sys
from pathlib import Path
from threading import Thread
from play_launch.process.time_slice import ask_for_more_turns, ask_for_short_turns

os.setsid()
given = int(sys.argv[2])
os.setpriority(os.PRIO_PROCESS, 0, given)
if sys.argv[1] == "without":
    resource.setrlimit(resource.RLIMIT_NICE, (0, 0))
    os.setuid(65534)
permitted = ask_for_more_turns()
ask_for_short_turns()
def show():
    group = Path("/proc/self/autogroup")
    print(permitted, os.getpriority(os.PRIO_PROCESS, 0),
          group.read_text().split()[-1] if group.exists() else "none")
thread = Thread(target=show)
thread.start()
thread.join()
"""


def preferred(right: str, nice: int) -> list[str]:
    command = [sys.executable, "-c", PREFERRING, right, str(nice)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, for nice values below 0")
def test_whoever_may_is_preferred_in_its_group_and_with_it() -> None:
    permitted, nice, group = preferred("with", 0)
    assert (permitted, nice) == ("True", str(NICE))
    assert group in (str(NICE), "none")


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to give the right up")
def test_whoever_may_not_goes_on_as_before() -> None:
    assert preferred("without", 0)[:2] == ["False", "0"]


def test_a_nice_value_that_somebody_gave_is_left_alone() -> None:
    assert preferred("with", 4)[:2] == ["False", "4"]
