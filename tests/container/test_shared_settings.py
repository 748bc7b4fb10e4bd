"""Which settings of a process are a node's own, as the documentation says."""

from __future__ import annotations

import os
import resource
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from std_msgs.msg import String

from tests.support.isolated import start, survives
from tests.support.ros import Probe

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.control_peer import StartContainer


def line_of_status(pid: int, name: str) -> str:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(line for line in lines if line.startswith(name))


SETTINGS: dict[str, Callable[[int], object]] = {
    "cwd": lambda pid: Path(f"/proc/{pid}/cwd").readlink(),
    "umask": lambda pid: line_of_status(pid, "Umask"),
    "limit": lambda pid: resource.prlimit(pid, resource.RLIMIT_NOFILE),
}
"""What the node sets in a callback, and how it is seen from outside: of the process."""

PRIVILEGED: dict[str, Callable[[int], object]] = {
    "root": lambda pid: Path(f"/proc/{pid}/root").readlink(),
    "uid": lambda pid: line_of_status(pid, "Uid"),
}
"""The same; only the superuser may set them."""

OF_THREADS: dict[str, Callable[[int], object]] = {
    "priority": lambda tid: os.getpriority(os.PRIO_PROCESS, tid),
    "scheduler": os.sched_getscheduler,
    "affinity": os.sched_getaffinity,
}
"""Settings of the thread that calls."""

may_do_anything = os.geteuid() == 0
has_processors = len(os.sched_getaffinity(0)) > 1


@pytest.mark.parametrize("how", [*SETTINGS, *(PRIVILEGED if may_do_anything else ())])
def test_a_setting_of_the_node_s_process(spawn: StartContainer, how: str) -> None:
    look = {**SETTINGS, **PRIVILEGED}[how]
    container = start(spawn, "isolated_mt")
    with survives(container), Probe() as probe:
        neighbour = container.loaded("Talker", parameters={"rate": 100.0})
        before = look(container.process.pid)
        vandal = container.loaded("Vandal", parameters={"how": how})
        probe.collect(String, "/vandal", 5)
        later = container.loaded("Talker", node_name="later")
        assert look(vandal.pid) != before
        for pid in (container.process.pid, neighbour.pid, later.pid):
            assert look(pid) == before
        probe.collect(String, "/chatter", 5)


@pytest.mark.parametrize("how", [*OF_THREADS][: None if has_processors else -1])
def test_a_setting_of_the_thread_that_calls(spawn: StartContainer, how: str) -> None:
    look = OF_THREADS[how]
    container = start(spawn)
    with survives(container), Probe() as probe:
        neighbour = container.loaded("Talker", parameters={"rate": 100.0})
        before = look(container.process.pid)
        vandal = container.loaded("Vandal", parameters={"how": how})
        probe.collect(String, "/vandal", 5)
        later = container.loaded("Talker", node_name="later")
        threads = [int(entry.name) for entry in Path(f"/proc/{vandal.pid}/task").iterdir()]
        assert [look(tid) != before for tid in threads].count(True) == 1
        for pid in (container.process.pid, neighbour.pid, later.pid):
            assert look(pid) == before
        probe.collect(String, "/chatter", 5)
