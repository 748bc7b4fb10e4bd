"""Samples of real processes and of the machine."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.node_key import NodeKey
from play_launch.process.identity import read_stat
from play_launch.process.sampling import processes
from play_launch.process.sampling.machine import MachineSampler, core_times
from play_launch.process.sampling.processes import Sampler, Target, targets
from play_launch.supervisor.events import (
    ContainerState,
    ContainerStateChanged,
    MemoryKind,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
    ProcessSample,
    RunEvent,
    SubjectKind,
)
from play_launch.supervisor.view import SystemView
from tests.recording.test_states import EVENTS
from tests.support.waiting import until

MEGABYTE = 1_000_000
# For each line it gets, it touches as many bytes, and answers.
GROWING = """
import sys
kept = []
for line in sys.stdin:
    kept.append(b"x" * int(line))
    print(len(kept), flush=True)
"""
TICK = 1 / os.sysconf("SC_CLK_TCK")


@contextmanager
def running(program: str) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def grow(process: subprocess.Popen[str], size: int) -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{size}\n")
    process.stdin.flush()
    assert process.stdout.readline()
    # It answered, and goes to sleep: what it uses does not change any more.
    until(lambda: psutil.Process(process.pid).status() == psutil.STATUS_SLEEPING, "its sleep")


def target(pid: int, start_time: int = 0, memory_of: int = 0) -> Target:
    return Target(SubjectKind.PROCESS, f"/p{pid}", pid, start_time, memory_of)


def one(sampler: Sampler, measured: Target) -> ProcessSample:
    (sample,) = sampler.sample([measured], stamp_ns=5)
    return sample


def test_the_cpu_time_of_a_hog_is_what_the_kernel_accounts() -> None:
    with running("while True: pass") as hog:
        sampler, measured = Sampler(), target(hog.pid)
        begin = time.monotonic()
        first = one(sampler, measured)
        after_first = time.monotonic()
        least = psutil.Process(hog.pid).cpu_times()
        while sum(psutil.Process(hog.pid).cpu_times()[:2]) < first.cpu_seconds + 0.2:
            os.sched_yield()
        before_second = time.monotonic()
        second = one(sampler, measured)
        end = time.monotonic()
        most = psutil.Process(hog.pid).cpu_times()
    used = second.cpu_seconds - first.cpu_seconds
    assert used >= 0.2 - TICK
    assert sum(least[:2]) - 2 * TICK <= second.cpu_seconds <= sum(most[:2]) + 2 * TICK
    assert 100 * used / (end - begin) <= second.cpu_percent
    assert second.cpu_percent <= 100 * used / (before_second - after_first)
    # What it could not have, it was kept from, and did not wait for.
    assert second.involuntary_switches >= first.involuntary_switches


def test_a_process_at_rest_uses_nothing() -> None:
    with running(GROWING) as idle:
        grow(idle, 1)
        sampler, measured = Sampler(), target(idle.pid)
        first, second = one(sampler, measured), one(sampler, measured)
    assert second.cpu_seconds == first.cpu_seconds
    assert second.cpu_percent == 0.0
    assert first.cpu_percent > 0.0, "since its start"


def test_numbers_are_those_of_psutil() -> None:
    with running(GROWING) as process:
        grow(process, MEGABYTE)
        sample = one(Sampler(), target(process.pid))
        theirs = psutil.Process(process.pid)
        assert abs(sample.memory_bytes - theirs.memory_full_info().pss) < MEGABYTE
        assert sample.threads == theirs.num_threads()
        assert sample.descriptors == theirs.num_fds()
        assert sample.voluntary_switches == theirs.num_ctx_switches().voluntary
        assert sample.involuntary_switches == theirs.num_ctx_switches().involuntary
        assert sample.read_bytes == theirs.io_counters().read_bytes
        assert sample.write_bytes == theirs.io_counters().write_bytes
        assert sample.start_time == read_stat(process.pid).start_time


@pytest.mark.parametrize("is_visible", [True, False])
def test_the_memory_of_a_leak_grows(is_visible: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(self: psutil.Process) -> None:
        raise psutil.AccessDenied(self.pid)

    if not is_visible:
        monkeypatch.setattr(psutil.Process, "memory_full_info", refused)
    monkeypatch.setattr(processes, "PERIOD", 0.0)
    with running(GROWING) as leak:
        grow(leak, 1)
        sampler, measured = Sampler(), target(leak.pid)
        before = one(sampler, measured)
        grow(leak, 50 * MEGABYTE)
        grown = one(sampler, measured)
    assert before.memory_kind is grown.memory_kind
    assert grown.memory_kind is (MemoryKind.PSS if is_visible else MemoryKind.RSS)
    assert grown.memory_bytes - before.memory_bytes > 45 * MEGABYTE


def test_a_node_has_the_memory_and_the_descriptors_of_its_container() -> None:
    with running(GROWING) as container, running(GROWING) as node:
        grow(container, MEGABYTE)
        grow(node, MEGABYTE)
        shared = Target(SubjectKind.NODE, "/c:/n", node.pid, 0, memory_of=container.pid)
        of_container, of_node = Sampler().sample([target(container.pid), shared], 5)
    assert of_container.memory_kind is MemoryKind.PSS
    assert of_node.memory_kind is MemoryKind.SHARED
    assert of_node.memory_bytes == of_container.memory_bytes
    assert of_node.descriptors == of_container.descriptors
    assert of_node.pid == node.pid


def test_a_process_that_has_ended_is_left_out() -> None:
    sampler = Sampler()
    with running(GROWING) as lives, running(GROWING) as ends:
        both = [target(ends.pid), target(lives.pid)]
        shared = target(lives.pid, memory_of=ends.pid)
        assert len(sampler.sample(both, 1)) == 2
        ends.kill()
        ends.wait()
        assert [each.pid for each in sampler.sample(both, 3)] == [lives.pid]
        # A node whose container has ended ends with it.
        assert sampler.sample([both[0], shared], 4) == []


def test_a_pid_with_a_new_owner_is_not_taken_for_the_old_one() -> None:
    with running(GROWING) as process:
        start_time = read_stat(process.pid).start_time
        assert len(Sampler().sample([target(process.pid, start_time)], 1)) == 1
        assert Sampler().sample([target(process.pid, start_time - 1)], 1) == []


def test_this_machine(tmp_path: Path) -> None:
    machine = MachineSampler(tmp_path)
    begin = psutil.cpu_times()
    while psutil.cpu_times() == begin:
        os.sched_yield()
    sample = machine.sample(7)
    assert sample.stamp_ns == 7
    assert 0 <= sample.cpu_percent <= 100
    assert len(sample.core_percent) == psutil.cpu_count()
    assert all(0 <= core <= 100 for core in sample.core_percent)
    assert len(sample.core_mhz) in (0, len(sample.core_percent))
    assert sample.memory_total == psutil.virtual_memory().total
    assert 0 < sample.memory_available < sample.memory_total
    assert sample.shm_total == psutil.disk_usage("/dev/shm").total
    assert 0 <= sample.shm_used <= sample.shm_total
    assert 0 < sample.disk_free <= psutil.disk_usage(str(tmp_path)).total
    assert min(sample.load_1, sample.load_5, sample.load_15) >= 0


def test_a_core_that_is_offline_has_no_percentage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "cpu  {0} 0 0 9 0 0 0 0\ncpu0 {0} 0 0 9 0 0 0 0\ncpu2 {0} 0 0 9 0 0 0 0\nintr 5 cpu"
    real = Path.read_text
    ticks = iter((9, 19))

    def read(path: Path, encoding: str) -> str:
        is_it = str(path) == "/proc/stat"
        return text.format(next(ticks)) if is_it else real(path, encoding)

    monkeypatch.setattr(Path, "read_text", read)
    percent = MachineSampler(tmp_path).sample(2).core_percent
    assert [math.isnan(one) for one in percent] == [False, True, False]
    assert percent[0] == 100


def test_times_of_cores() -> None:
    text = "cpu  4 1 1 20 5 1 1 3 9 9\ncpu3 2 1 1 10 5 1 1 3 9 9\nintr 5 cpu"
    assert core_times(text) == {-1: (8, 25, 3), 3: (6, 15, 3)}


def view_of(*events: RunEvent) -> SystemView:
    view = SystemView()
    for event in events:
        view = view.after(event)
    return view


def started(name: str, pid: int) -> ProcessEvent:
    return ProcessEvent(
        stamp_ns=1, kind=ProcessEventKind.STARTED, name=name, pid=pid, start_time=pid + 1000
    )


def box(mechanism: str) -> ContainerStateChanged:
    return ContainerStateChanged(
        stamp_ns=1, container="/box", state=ContainerState.RUNNING, mechanism=mechanism
    )


def node(state: NodeState, pid: int, name: str = "/talker") -> NodeStateChanged:
    key = NodeKey("/box", name)
    return NodeStateChanged(stamp_ns=1, key=key, state=state, pid=pid, start_time=pid + 1000)


CONTAINER = Target(SubjectKind.CONTAINER, "/box", 7, 1007)


def test_nodes_of_a_container_that_stops_are_not_taken_for_processes_of_their_own() -> None:
    view = view_of(box("shared_memory"), started("/box", 7), node(NodeState.LOADED, 8))
    stopping = ContainerStateChanged(
        stamp_ns=1, container="/box", state=ContainerState.STOPPING, mechanism=""
    )
    assert targets(view.after(stopping)) == [CONTAINER]


def test_a_crashed_node_has_no_process_though_its_pid_is_known() -> None:
    view = view_of(box("shared_memory"), started("/box", 7), node(NodeState.CRASHED, 8))
    assert targets(view) == [CONTAINER]


@given(st.lists(EVENTS, max_size=30))
def test_whatever_happened_memory_is_shared_with_a_container_that_is_measured_before(
    events: list[RunEvent],
) -> None:
    measured: dict[int, Target] = {}
    for target in targets(view_of(*events)):
        assert target.pid
        if target.memory_of:
            assert measured[target.memory_of].kind is SubjectKind.CONTAINER
        measured[target.pid] = target
