"""Who wants a processor and gets none is told from who sleeps, by what the kernel counts."""

from __future__ import annotations

import ctypes
import mmap
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from play_launch.process.identity import ProcessIdentity, read_stat
from play_launch.process.processor_wait import (
    ProcessorWait,
    processor_wait,
    thread_wait,
)
from tests.support.waiting import until

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
    until(lambda: processor_wait(first, {"busy"}).seconds > 0.01, "a wait for the other")
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


SEM_T = 32
"""Bytes of a sem_t; it holds more nowhere."""
LIBC = ctypes.CDLL(None)


@pytest.fixture
def semaphore() -> Iterator[int]:
    """The address of a semaphore that processes share, at 0."""
    with mmap.mmap(-1, mmap.PAGESIZE) as memory:
        held = (ctypes.c_char * SEM_T).from_buffer(memory)
        address = ctypes.addressof(held)
        assert LIBC.sem_init(ctypes.c_void_p(address), 1, 0) == 0
        yield address
        del held


def forked(name: bytes, wait: Callable[[], object]) -> ProcessIdentity:
    """A child with this name that waits, and exits with 0 when that is over."""
    pid = os.fork()
    if pid == 0:
        try:
            LIBC.prctl(15, name, 0, 0, 0)  # PR_SET_NAME
            wait()
        finally:
            os._exit(0)
    return read_stat(pid).identity


def until_asleep(process: ProcessIdentity, name: str) -> None:
    while (stat := read_stat(process.pid)).state != "S" or stat.command != name:
        os.sched_yield()


def test_being_asked_does_no_harm(semaphore: int) -> None:
    process = forked(b"load-7", lambda: LIBC.sem_wait(ctypes.c_void_p(semaphore)))
    try:
        until_asleep(process, "load-7")
        while not thread_wait(process, ""):  # it may be in state S and still on a processor
            os.sched_yield()
        said = {thread_wait(process, name) for name in ("", "load-7") for _ in range(100)}
        other = thread_wait(process, "load-8")
        LIBC.sem_post(ctypes.c_void_p(semaphore))
        assert os.waitpid(process.pid, 0)[1] == 0
    except BaseException:
        os.kill(process.pid, signal.SIGKILL)
        os.waitpid(process.pid, 0)
        raise
    assert len(said) == 1
    assert re.fullmatch(r"waits in \w*futex\w* of the kernel", said.pop())
    assert other == ""
    assert thread_wait(process, "") == thread_wait(process, "load-7") == ""


def test_a_process_that_has_the_pid_of_another_is_not_meant(semaphore: int) -> None:
    process = forked(b"load-7", lambda: LIBC.sem_wait(ctypes.c_void_p(semaphore)))
    try:
        until_asleep(process, "load-7")
        assert thread_wait(ProcessIdentity(process.pid, process.start_time + 1), "") == ""
    finally:
        LIBC.sem_post(ctypes.c_void_p(semaphore))
        os.waitpid(process.pid, 0)
