"""Short turns, more of them, and real-time scheduling of the supervisor's threads."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from play_launch.process.time_slice import NICE

OURS = os.getpriority(os.PRIO_PROCESS, 0)
"""The nice value that all of this has."""
KERNEL = tuple(int(part) for part in platform.release().split("-")[0].split(".")[:2])
has_slices = pytest.mark.skipif(KERNEL < (6, 12), reason="slices are for Linux 6.12 and later")
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to give the right up")
WITHOUT = """
if sys.argv[1] == "without":
    for limit in (resource.RLIMIT_RTPRIO, resource.RLIMIT_NICE):
        resource.setrlimit(limit, (0, 0))
    os.setuid(65534)
"""
IMPORTS = """
import asyncio, os, resource, signal, subprocess, sys
from pathlib import Path
from threading import Event, Thread
from play_launch.process.time_slice import (
    ask_for_more_turns, ask_for_short_turns, run_ahead, run_along,
)

def in_a_thread(function):
    thread = Thread(target=function)
    thread.start()
    thread.join()

def slice_of(task):
    lines = Path(f"/proc/{task}/sched").read_text().splitlines()
    # Kernels without the scheduler's debugging do not show it.
    return [line.split()[-1] for line in lines if line.startswith("se.slice")] or ["hidden"]
"""


def run(program: str, *words: object) -> list[list[str]]:
    """The words of each line that a program prints."""
    command = [sys.executable, "-c", IMPORTS + program, *map(str, words)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60)
    return [line.split() for line in done.stdout.splitlines()]


def may_be_preferred() -> bool:
    """Whether we are root with CAP_SYS_NICE (23), which containers usually take away."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    (effective,) = (line.split()[1] for line in status.splitlines() if line.startswith("CapEff"))
    return os.geteuid() == 0 and bool(int(effective, 16) >> 23 & 1)


def may_run_ahead() -> bool:
    """Whether a real-time policy is allowed: control groups can forbid it despite the privilege."""
    taking = "import os; os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))"
    done = subprocess.run([sys.executable, "-c", taking], check=False, stderr=subprocess.DEVNULL)
    return may_be_preferred() and done.returncode == 0 and OURS == 0


@has_slices
def test_a_thread_and_those_it_starts_get_short_turns() -> None:
    ((taken, policy, found),) = run(
        "taken = ask_for_short_turns()\n"
        "in_a_thread(lambda: print(taken, os.sched_getscheduler(0), *slice_of('thread-self')))"
    )
    assert (taken, policy) == ("True", "0")
    assert found in {"100000", "hidden"}


STARTING = (
    "from play_launch.process.child import spawn\n"
    "from play_launch.process.guard import SessionGuard\n"
    + WITHOUT
    + """
def show(pid):
    policy = os.sched_getscheduler(pid) & ~os.SCHED_RESET_ON_FORK
    print(*["ahead"] if policy == os.SCHED_RR else slice_of(pid), os.getpriority(0, pid))

async def main():
    ask_for_short_turns()
    run_ahead()
    guard = SessionGuard.start(Path(sys.argv[2]))
    child = await spawn(["sleep", "1000"], env=os.environ, guard=guard)
    ours = subprocess.Popen(["sleep", "1000"])
    for pid in (child.pid, ours.pid):
        show(pid)
        os.kill(pid, signal.SIGKILL)
    ours.wait()
    show(guard.pid)
    guard.close()

asyncio.run(main())
"""
)


@has_slices
@needs_root
@pytest.mark.parametrize("right", ["with", "without"])
def test_what_a_guard_starts_has_the_usual_turns(guard: Path, right: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        # Where this runs, its own place may be reserved.
        program = Path(shutil.copy(guard, folder))
        Path(folder).chmod(0o755)
        of_child, of_ours, of_guard = run(STARTING, right, program)
    assert of_child[0] not in {"100000", "ahead"}
    assert of_ours[0] != "ahead"
    assert {each[1] for each in (of_child, of_ours, of_guard)} == {str(OURS)}
    assert of_guard[0] in {"100000", "hidden"}


AHEAD = (
    "os.nice(int(sys.argv[2]))"
    + WITHOUT
    + """
over = Event()
other = Thread(target=over.wait)
other.start()
def show(*results):
    # A thread that was joined may still be among those of /proc.
    policies = [os.sched_getscheduler(each) & ~os.SCHED_RESET_ON_FORK
                for each in (os.getpid(), other.native_id)]
    late = []
    in_a_thread(lambda: late.append(os.sched_getscheduler(0)))
    child = os.fork()
    if child == 0:
        os._exit(os.sched_getscheduler(0))
    child = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    print(*results, *policies, *late, child)
try:
    show(run_ahead())
    run_along()
    show()
    show(run_ahead())
finally:
    over.set()
"""
)


@pytest.mark.skipif(
    not may_run_ahead(), reason="needs root with CAP_SYS_NICE, real-time policies and no nice value"
)
def test_with_the_right_all_threads_are_real_time_and_what_they_start_is_not() -> None:
    ahead = f"True {os.SCHED_RR} {os.SCHED_RR} {os.SCHED_OTHER} {os.SCHED_OTHER}".split()
    assert run(AHEAD, "with", 0) == [ahead, ["0"] * 4, ahead]


@needs_root
@pytest.mark.parametrize(("right", "nice"), [("without", 0), ("with", 5)])
def test_without_the_right_or_with_a_nice_value_nothing_is_real_time(right: str, nice: int) -> None:
    refused = ["False", *["0"] * 4]
    assert run(AHEAD, right, nice) == [refused, ["0"] * 4, refused]


PREFERRING = (
    "os.setsid(); os.setpriority(os.PRIO_PROCESS, 0, int(sys.argv[2]))"
    + WITHOUT
    + """
permitted = ask_for_more_turns()
ask_for_short_turns()
group = Path("/proc/self/autogroup")
of_group = group.read_text().split()[-1] if group.exists() else "none"
in_a_thread(lambda: print(permitted, os.getpriority(os.PRIO_PROCESS, 0), of_group))
"""
)


@pytest.mark.skipif(not may_be_preferred(), reason="needs root with CAP_SYS_NICE")
def test_with_the_right_a_process_and_its_group_get_more_turns() -> None:
    ((permitted, nice, group),) = run(PREFERRING, "with", 0)
    assert (permitted, nice) == ("True", str(NICE))
    assert group in {str(NICE), "none"}


@needs_root
@pytest.mark.parametrize(("right", "nice"), [("without", 0), ("with", 4)])
def test_without_the_right_or_with_a_nice_value_it_is_left_alone(right: str, nice: int) -> None:
    ((permitted, found, _),) = run(PREFERRING, right, nice)
    assert (permitted, found) == ("False", str(nice))
