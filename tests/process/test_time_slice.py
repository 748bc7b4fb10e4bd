"""Whose work is short and waited for gets short turns, more of them, or runs ahead."""

from __future__ import annotations

import errno
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from play_launch.process.time_slice import NICE, run_ahead, run_along

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

OURS = os.getpriority(os.PRIO_PROCESS, 0)
"""The nice value that all of this has."""


def kernel() -> tuple[int, ...]:
    return tuple(int(part) for part in platform.release().split("-")[0].split(".")[:2])


def may_be_preferred() -> bool:
    """Whether we are root with CAP_SYS_NICE (23), which containers usually take away."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    (effective,) = (line.split()[1] for line in status.splitlines() if line.startswith("CapEff"))
    return os.geteuid() == 0 and bool(int(effective, 16) >> 23 & 1)


def may_run_ahead() -> bool:
    """Whether we may take a real-time policy: control groups can forbid it to those who may."""
    taking = "import os; os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))"
    run = subprocess.run([sys.executable, "-c", taking], check=False, stderr=subprocess.DEVNULL)
    return may_be_preferred() and run.returncode == 0 and os.getpriority(os.PRIO_PROCESS, 0) == 0


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
import asyncio, os, signal, sys
from pathlib import Path
from play_launch.process.child import spawn
from play_launch.process.guard import SessionGuard
from play_launch.process.time_slice import ask_for_short_turns, run_ahead

def show(pid):
    lines = Path(f"/proc/{pid}/sched").read_text().splitlines()
    policy = os.sched_getscheduler(pid) & ~os.SCHED_RESET_ON_FORK
    slices = [line.split()[-1] for line in lines if line.startswith("se.slice")] or [""]
    print("ahead" if policy == os.SCHED_RR else slices[0], os.getpriority(os.PRIO_PROCESS, pid))

async def main():
    if sys.argv[2] == "without":
        os.setuid(65534)
    ask_for_short_turns()
    run_ahead()
    guard = SessionGuard.start(Path(sys.argv[1]))
    for starter in (guard, None):
        child = await spawn(["sleep", "1000"], env=os.environ, guard=starter)
        show(child.pid)
        os.kill(child.pid, signal.SIGKILL)
    show(guard.pid)
    guard.close()

asyncio.run(main())
"""


def started(guard: Path, right: str) -> list[str]:
    command = [sys.executable, "-c", STARTING, str(guard), right]
    run = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60)
    return run.stdout.splitlines()


def test_what_a_guard_starts_has_the_usual_turns(guard: Path) -> None:
    right = "with" if may_run_ahead() else "as it is"
    of_its_child, of_ours, of_guard = started(guard, right)
    assert all(each.endswith(f" {OURS}") for each in (of_its_child, of_ours))
    assert of_its_child != f"100000 {OURS}"
    assert f"ahead {OURS}" not in (of_its_child, of_ours)
    # Kernels without the scheduler's debugging do not show it.
    assert of_guard in (f"100000 {OURS}", f" {OURS}") or kernel() < (6, 12)


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to give the right up")
def test_a_guard_without_the_right_has_short_turns(guard: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        # Where this runs, its own place may be for nobody else.
        program = Path(shutil.copy(guard, folder))
        Path(folder).chmod(0o755)
        of_child, *_, of_guard = started(program, "without")
    # Kernels without the scheduler's debugging do not show it.
    assert of_guard in (f"100000 {OURS}", f" {OURS}") or kernel() < (6, 12)
    assert of_child not in (f"100000 {OURS}", f"ahead {OURS}")


AHEAD = """
import os, resource, sys
from threading import Event, Thread
from play_launch.process.time_slice import run_ahead, run_along

os.nice(int(sys.argv[2]))
if sys.argv[1] == "without":
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    os.setuid(65534)
over = Event()
other = Thread(target=over.wait)
other.start()
def show(*results):
    # A thread that was joined may still be among those of /proc.
    policies = [os.sched_getscheduler(each) & ~os.SCHED_RESET_ON_FORK
                for each in (os.getpid(), other.native_id)]
    late = []
    thread = Thread(target=lambda: late.append(os.sched_getscheduler(0)))
    thread.start()
    thread.join()
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


def ahead(right: str, nice: int) -> list[str]:
    command = [sys.executable, "-c", AHEAD, right, str(nice)]
    run = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60)
    return run.stdout.splitlines()


@pytest.mark.skipif(
    not may_run_ahead(), reason="needs root with CAP_SYS_NICE, real-time policies and no nice value"
)
def test_whoever_may_runs_ahead_with_all_threads_but_not_with_what_it_starts() -> None:
    runs_ahead = f"True {os.SCHED_RR} {os.SCHED_RR} {os.SCHED_OTHER} {os.SCHED_OTHER}"
    assert ahead("with", 0) == [runs_ahead, "0 0 0 0", runs_ahead]


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to give the right up")
@pytest.mark.parametrize(("right", "nice"), [("without", 0), ("with", 5)])
def test_whoever_may_not_or_is_to_stand_back_does_not(right: str, nice: int) -> None:
    assert ahead(right, nice) == ["False 0 0 0 0", "0 0 0 0", "False 0 0 0 0"]


@pytest.mark.parametrize("reason", [errno.EPERM, errno.EINVAL, errno.ENOSYS])
def test_a_refusal_changes_nothing(reason: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(reason, "refused")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert not run_ahead()
    run_along()


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


@pytest.mark.skipif(not may_be_preferred(), reason="needs root with CAP_SYS_NICE")
def test_whoever_may_is_preferred_in_its_group_and_with_it() -> None:
    permitted, nice, group = preferred("with", 0)
    assert (permitted, nice) == ("True", str(NICE))
    assert group in (str(NICE), "none")


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to give the right up")
def test_whoever_may_not_goes_on_as_before() -> None:
    assert preferred("without", 0)[:2] == ["False", "0"]


def test_a_nice_value_that_somebody_gave_is_left_alone() -> None:
    assert preferred("with", 4)[:2] == ["False", "4"]
