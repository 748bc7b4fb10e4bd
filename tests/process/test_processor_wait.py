"""Who wants a processor and gets none is told from who sleeps, by what the kernel counts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from play_launch.process.processor_wait import ProcessorWait, own_wait, processor_wait

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

NAMED = """
import ctypes, os, sys, threading
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
libc = ctypes.CDLL(None)
def work(name, busy):
    libc.prctl(15, name.encode(), 0, 0, 0)
    print(name, flush=True)
    while busy:
        pass
    threading.Event().wait()
threading.Thread(target=work, args=(sys.argv[1], sys.argv[1] == "busy")).start()
"""
counted = pytest.mark.skipif(
    not Path("/proc/self/schedstat").exists(), reason="this kernel does not count (SCHED_INFO)"
)


@pytest.fixture
def start() -> Iterator[Callable[[str], int]]:
    started: list[subprocess.Popen[str]] = []

    def start(name: str) -> int:
        command = [sys.executable, "-c", NAMED, name]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == f"{name}\n"
        return process.pid

    yield start
    for each in started:
        each.kill()
        each.communicate()


@counted
def test_two_that_share_a_processor_wait_for_each_other(start: Callable[[str], int]) -> None:
    first, second = start("busy"), start("busy")
    while not processor_wait(first, {"busy"}).seconds > 0.01:
        assert os.waitid(os.P_PID, second, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None
    assert processor_wait(first, {"busy"}).wants_one
    assert processor_wait(first, {"other"}) == ProcessorWait(0.0, wants_one=False)
    os.kill(first, signal.SIGSTOP)
    until_stopped(first)
    assert not processor_wait(first, {"busy"}).wants_one


def until_stopped(pid: int) -> None:
    os.waitid(os.P_PID, pid, os.WSTOPPED | os.WNOWAIT)


def test_who_sleeps_wants_none(start: Callable[[str], int]) -> None:
    pid = start("sleeper")
    while processor_wait(pid, {"sleeper"}).wants_one:  # it has not come to its sleep yet
        os.sched_yield()
    assert processor_wait(pid, {"sleeper"}).wants_one is False


def test_what_is_gone_has_not_waited() -> None:
    process = subprocess.Popen(["true"])
    process.wait()
    assert processor_wait(process.pid, {"true"}) == ProcessorWait(0.0, wants_one=False)


@counted
def test_we_ourselves_have_waited_at_some_time() -> None:
    before = own_wait()
    assert 0 <= before.seconds <= own_wait().seconds
