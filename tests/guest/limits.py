"""Control groups on real machines; run by `cases/cgroups`, where there are controllers."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from play_launch.config.resources import GroupLimits, GroupPolicy
from play_launch.process.cgroups.group import SUPERVISOR, Group, GroupError
from play_launch.process.cgroups.session_groups import SessionGroups

TOP = Path("/sys/fs/cgroup")
BASE = TOP / "robot" / "inner"
ALL = ("cpu", "cpuset", "memory", "pids")
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
        cpus_that_are_not_there_are_left_out,
        processes_of_the_base_move_to_a_leaf,
        a_base_with_processes_is_refused,
    )
    for test in tests:
        test()
        print(f"{test.__name__}: passed", flush=True)


if __name__ == "__main__":
    main()
