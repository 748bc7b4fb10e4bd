"""What a node does to descriptors and settings that it shares with others, or has of its own."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from play_launch_msgs.msg import ControlQuery
from std_msgs.msg import String

from play_launch.ros.fastdds.shared_memory import sweep
from tests.support.control_peer import Container, StartContainer
from tests.support.isolated import MODES, start, survives
from tests.support.ros import Probe


def open_files(container: Container) -> set[str]:
    """What the container has open."""
    files = set()
    for entry in Path(f"/proc/{container.process.pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # some are open for a moment only
            files.add(str(entry.readlink()))
    return files


@pytest.mark.parametrize("mode", MODES)
def test_garbage_in_low_descriptors_does_no_harm(
    spawn: StartContainer, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    with survives(container):
        container.loaded("Talker", parameters={"rate": 100.0})
        container.loaded("Vandal", parameters={"how": "garbage"})
        probe.collect(String, "/vandal", 5)  # it has done it, and goes on
        probe.collect(String, "/chatter", 5)
        container.loaded("Talker", node_name="another")
        assert not container.status().dead_locks


@pytest.mark.parametrize("mode", MODES)
def test_a_loop_over_low_descriptors_leaves_the_control_channel(
    spawn: StartContainer, mode: str
) -> None:
    container = start(spawn, mode)
    container.loaded("Vandal", parameters={"how": "close_low"})
    assert container.control_socket in open_files(container)
    container.status()
    container.shut_down()
    sweep()  # the lock files by which the container finds its segments are closed as well


def test_a_channel_that_is_closed_from_within_is_called_that(spawn: StartContainer) -> None:
    container = start(spawn)
    container.loaded("Vandal", parameters={"how": "close_all"})
    while container.control_socket in open_files(container):
        time.sleep(0.01)
    container.send(ControlQuery(query_id=1))  # wakes the thread that waits for the closed socket
    assert container.wait() == 0
    sweep()
    log = container.log.read_text()
    assert "the control channel's descriptor was closed or replaced within this process" in log
    assert "supervisor is gone" not in log


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
