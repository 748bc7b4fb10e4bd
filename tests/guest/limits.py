"""Limits of control groups hold; run by `cases/cgroups`, in a machine that has the controllers."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from play_launch.config.resources import CpuMax, GroupLimits, GroupPolicy
from play_launch.process.cgroups.group import SUPERVISOR, Group, GroupError, why_killed
from play_launch.process.cgroups.session import SessionGroups
from play_launch.process.cgroups.usage import group_of, usage_of
from play_launch.process.sampling.groups import GroupSampler
from play_launch.process.sampling.processes import Target
from play_launch.supervisor.events import SubjectKind

TOP = Path("/sys/fs/cgroup")
BASE = TOP / "robot" / "inner"
ALL = ("cpu", "cpuset", "memory", "pids")
SPIN = "while :; do :; done"
FILL = "import os; os.write(1, b'.'); data = b'x' * (200 << 20); os.write(1, b'!')"
FORK = "for i in 1 2 3 4 5 6 7 8; do sleep 600 & done; wait"

messages: list[str] = []


class Collector(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        messages.append(record.getMessage())


def started(
    groups: SessionGroups, name: str, limits: GroupLimits, *command: str
) -> tuple[Group, subprocess.Popen[bytes]]:
    made = groups.member(name, limits)
    assert made is not None
    script = 'echo 0 > "$0"/cgroup.procs && exec "$@"'
    folder = made[1].partition(" ")[2]
    process = subprocess.Popen(["sh", "-c", script, folder, *command], stdout=subprocess.PIPE)
    while process.pid not in made[0].residents() and process.poll() is None:
        time.sleep(0.01)
    return made[0], process


def share(group: Group) -> float:
    """Percent of a CPU that a group uses in the next seconds."""
    then, began = group.numbers("cpu.stat")["usage_usec"], time.monotonic()
    time.sleep(3)
    used = group.numbers("cpu.stat")["usage_usec"] - then
    return used / 1e4 / (time.monotonic() - began)


def limits_hold() -> None:
    groups = SessionGroups()
    groups.begin(GroupPolicy(base_path=BASE, required=True), ALL)
    half, spinning = started(
        groups, "/half", GroupLimits(cpu_max=CpuMax(50_000), cpuset=(1,)), "sh", "-c", SPIN
    )
    _, forking = started(groups, "/forking", GroupLimits(pids_max=5), "sh", "-c", FORK)
    # Whoever runs this machine may have no time for it, and then its processes have none either.
    used = 0.0
    for _ in range(10):
        used = share(half)
        print(f"cpu_max 50 %: {used:.1f} %")
        assert used < 55
        if used > 45:
            break
    assert used > 45
    assert half.numbers("cpu.stat")["nr_throttled"] > 0
    status = Path(f"/proc/{spinning.pid}/status").read_text()
    assert "Cpus_allowed_list:\t1\n" in status
    known = group_of(spinning.pid)
    assert known is not None
    assert known.path == half.path
    usage = usage_of(known)
    print(usage)
    assert usage.throttled_periods
    assert usage.throttled_seconds
    crowd = Group(BASE / half.path.parent.name / "forking")
    assert crowd.numbers("pids.events")["max"] > 0
    assert len(crowd.processes()) <= 5
    (sleeper, *_) = crowd.processes()
    sampler = GroupSampler()
    looked_at = [
        Target(SubjectKind.PROCESS, name, pid, 0)
        for name, pid in (("/half", spinning.pid), ("/forking", sleeper))
    ]
    (sample, other), (said,) = sampler.sample(looked_at, 1)
    print(said, sample)
    assert sample.throttled_periods > 0
    assert sample.throttled_seconds > 0
    assert other.pids_max_hits > 0
    assert "could not be started: pids_max 5 of its control group is reached" in said

    full, filling = started(
        groups, "/full", GroupLimits(memory_max=64 << 20), sys.executable, "-S", "-c", FILL
    )
    assert filling.communicate()[0] == b"."
    assert filling.returncode == -signal.SIGKILL
    said = why_killed(full)
    print(said)
    assert said == "killed by the kernel: memory.max 64 MiB of its control group"
    groups.end()
    assert spinning.wait() == -signal.SIGKILL
    forking.wait()
    assert not list(BASE.glob("*/")), messages


def cpus_that_are_not_there_are_left_out() -> None:
    groups = SessionGroups()
    groups.begin(GroupPolicy(base_path=BASE), ["cpuset"])
    messages.clear()
    group, process = started(groups, "/wide", GroupLimits(cpuset=tuple(range(8))), "sleep", "600")
    (said,) = messages
    print(said)
    assert said == (
        "/wide: cpuset 0-7 has CPUs that this machine, or the group above, has not: "
        "there are 0-1; fix: name those"
    )
    assert (group.path / "cpuset.cpus").read_text() == "0-1\n"
    groups.end()
    process.wait()


def processes_of_the_base_move_to_a_leaf() -> None:
    """As in a Docker container or a scope, where everything is in the group that is delegated."""
    scope = Group(TOP / "a.scope")
    scope.make()
    list(Group(TOP).enable(ALL, top=TOP))
    scope.move_here([os.getpid()])
    neighbour = subprocess.Popen(["sleep", "600"])
    groups = SessionGroups()
    groups.begin(GroupPolicy(required=True), ALL)
    assert sorted(scope.text("cgroup.subtree_control").split()) == sorted(ALL)
    leaf = Group(scope.path / SUPERVISOR)
    assert sorted(leaf.residents()) == sorted([os.getpid(), neighbour.pid])
    _, process = started(groups, "/a", GroupLimits(cpu_weight=50), "sleep", "600")
    groups.end()
    assert process.wait() == -signal.SIGKILL
    neighbour.kill()
    neighbour.wait()
    Group(TOP).move_here([os.getpid()])
    assert scope.remove()


def a_base_with_processes_is_refused() -> None:
    base = Group(TOP / "busy")
    base.make()
    with subprocess.Popen(["sleep", "600"]) as process:
        base.move_here([process.pid])
        said = ""
        try:
            SessionGroups().begin(GroupPolicy(base_path=base.path, required=True), ["memory"])
        except GroupError as error:
            said = str(error)
        print(said)
        assert "cannot be enabled in /sys/fs/cgroup/busy: Device or resource busy; fix: " in said
        process.kill()
    base.path.rmdir()


def main() -> None:
    logging.getLogger("play_launch").addHandler(Collector())
    tests: tuple[Callable[[], None], ...] = (
        limits_hold,
        cpus_that_are_not_there_are_left_out,
        processes_of_the_base_move_to_a_leaf,
        a_base_with_processes_is_refused,
    )
    for test in tests:
        test()
        print(f"{test.__name__}: passed", flush=True)


if __name__ == "__main__":
    main()
