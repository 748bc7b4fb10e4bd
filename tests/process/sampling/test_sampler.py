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
from play_launch.process.sampling import process_usage
from play_launch.process.sampling.process_usage import (
    ProcessFiles,
    ProcessUsage,
    proportional_set_size,
)
from play_launch.process.sampling.sampler import PSS_PERIOD, Sampler
from play_launch.process.sampling.targets import Target
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


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


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


def test_the_memory_of_a_leak_grows_and_holds_from_one_pss_to_the_next() -> None:
    clock = Clock()
    with running(GROWING) as leak:
        grow(leak, 1)
        sampler, measured = Sampler(clock), target(leak.pid)
        before = one(sampler, measured)
        grow(leak, 50 * MEGABYTE)
        clock.now += PSS_PERIOD / 2
        held = one(sampler, measured)
        clock.now += PSS_PERIOD / 2
        grown = one(sampler, measured)
    assert [each.memory_kind for each in (before, held, grown)] == [MemoryKind.PSS] * 3
    assert held.memory_bytes == before.memory_bytes
    assert grown.memory_bytes - before.memory_bytes > 45 * MEGABYTE


def test_memory_that_may_not_be_looked_at_is_counted_in_full(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        "play_launch.process.sampling.sampler.proportional_set_size", lambda _: None
    )
    with running(GROWING) as leak:
        grow(leak, 1)
        sampler, measured = Sampler(), target(leak.pid)
        before = one(sampler, measured)
        grow(leak, 50 * MEGABYTE)
        grown = one(sampler, measured)
        theirs = psutil.Process(leak.pid).memory_info().rss
        assert abs(grown.memory_bytes - theirs) < MEGABYTE
    assert before.memory_kind is grown.memory_kind is MemoryKind.RSS
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
        os.waitid(os.P_PID, ends.pid, os.WEXITED | os.WNOWAIT)
        # A zombie at first, then nothing.
        assert [each.pid for each in sampler.sample(both, 2)] == [lives.pid]
        ends.wait()
        assert [each.pid for each in sampler.sample(both, 3)] == [lives.pid]
        # A node whose container has ended ends with it.
        assert sampler.sample([both[0], shared], 4) == []


def test_a_pid_with_a_new_owner_is_not_taken_for_the_old_one() -> None:
    with running(GROWING) as process:
        start_time = read_stat(process.pid).start_time
        assert len(Sampler().sample([target(process.pid, start_time)], 1)) == 1
        assert Sampler().sample([target(process.pid, start_time - 1)], 1) == []


def test_a_pid_with_an_unknown_start_keeps_its_first_owner(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with running(GROWING) as process:
        sampler, measured = Sampler(), target(process.pid)
        first = one(sampler, measured)
        usage = process_usage.process_usage(process.pid)
        assert usage is not None
        other = usage._replace(start_time=first.start_time + 1)
        monkeypatch.setattr(ProcessFiles, "usage", lambda *_, **__: other)
        assert sampler.sample([measured], 2) == []


@pytest.mark.parametrize("most", [0, 128])
def test_files_are_kept_open_for_some_processes_and_until_they_end(
    monkeypatch: pytest.MonkeyPatch, most: int
) -> None:
    monkeypatch.setattr("play_launch.process.sampling.sampler._MOST_KEPT", most)
    sampler, me = Sampler(), psutil.Process()
    with running(GROWING) as process:
        before, measured = me.num_fds(), target(process.pid)
        samples = [one(sampler, measured) for _ in range(3)]
        assert me.num_fds() - before == (2 if most else 0)
        assert {each.start_time for each in samples} == {read_stat(process.pid).start_time}
        process.kill()
        # A zombie has a status, too.
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        assert sampler.sample([measured], 5) == []
        process.wait()
        assert sampler.sample([measured], 5) == []
        assert sampler.sample([], 5) == []
        assert me.num_fds() <= before


def test_the_files_stay_those_of_their_process() -> None:
    with running(GROWING) as process:
        files = ProcessFiles(process.pid)
        assert files.usage() is not None
        process.kill()
        process.wait()
        # Whoever has this pid now.
        files.pid = os.getpid()
        assert files.usage() is None
        with pytest.raises(OSError, match=str(process.pid)):
            ProcessFiles(process.pid)


@pytest.mark.parametrize(("growth", "period"), [(2 * MEGABYTE, 10), (0, 60)])
def test_the_pss_of_many_processes_is_not_taken_at_once(
    monkeypatch: pytest.MonkeyPatch, growth: int, period: int
) -> None:
    taken: list[int] = []
    measured = process_usage.process_usage(os.getpid())
    assert measured is not None
    first = measured._replace(rss=50 * MEGABYTE)

    def usage(_: ProcessFiles, **__: object) -> ProcessUsage:
        return first._replace(rss=first.rss + growth * round(clock.now))

    def pss(pid: int) -> int:
        taken.append(pid)
        return 1

    monkeypatch.setattr("play_launch.process.sampling.sampler.proportional_set_size", pss)
    monkeypatch.setattr(ProcessFiles, "usage", usage)
    clock = Clock()
    sampler = Sampler(clock)
    me = read_stat(os.getpid())
    many = [Target(SubjectKind.PROCESS, f"/{n}", me.pid, me.start_time) for n in range(25)]
    counts = []
    for _ in range(40 + 2 * period):
        before = len(taken)
        sampler.sample(many, 1)
        counts.append(len(taken) - before)
        clock.now += 1
    assert counts[0] == 10
    assert max(counts) == 10
    assert sum(counts[:4]) >= 25, "each has one"
    # From then on, each once in a period, and not all of them at the same time.
    assert sum(counts[-2 * period :]) == 50
    assert max(counts[-2 * period :]) <= 5


def test_a_command_may_be_called_anything() -> None:
    program = (
        "import ctypes, sys; ctypes.CDLL(None).prctl(15, b') R 1 (\\n', 0, 0, 0); "
        "print(1, flush=True); sys.stdin.read()"
    )
    with running(program) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        sample = one(Sampler(), target(process.pid))
        assert sample.threads == 1
        assert sample.start_time == read_stat(process.pid).start_time


def test_a_process_that_is_gone_has_no_pss() -> None:
    with running(GROWING) as process:
        process.kill()
        process.wait()
        assert proportional_set_size(process.pid) is None
        assert process_usage.process_usage(process.pid) is None
