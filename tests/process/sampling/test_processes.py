"""Samples of real processes."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

import psutil
import pytest

from play_launch.process.identity import read_stat
from play_launch.process.sampling import processes
from play_launch.process.sampling.processes import Sampler, Target
from play_launch.supervisor.events import MemoryKind, ProcessSample, SubjectKind
from tests.support.waiting import until

if TYPE_CHECKING:
    from collections.abc import Iterator

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


def test_the_memory_holds_for_its_period() -> None:
    with running(GROWING) as leak:
        sampler, measured = Sampler(), target(leak.pid)
        before = one(sampler, measured)
        grow(leak, 50 * MEGABYTE)
        assert one(sampler, measured).memory_bytes == before.memory_bytes


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
