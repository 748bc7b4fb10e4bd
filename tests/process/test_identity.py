"""Which process is meant, and whether it waits for a processor."""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.process.identity import (
    NoSuchProcessError,
    ProcessHandle,
    ProcessIdentity,
    ProcessStat,
    StatFormatError,
    list_processes,
    parse_stat,
    read_stat,
)
from play_launch.process.processor_wait import ProcessorWait, processor_wait, thread_wait
from tests.process.programs import python
from tests.support.waiting import until


@given(
    command=st.text(st.characters(exclude_categories=["Cs"]), max_size=30),
    pid=st.integers(1, 2**22),
    start_time=st.integers(0, 2**63),
    state=st.sampled_from("RSDZTtXI"),
)
def test_stat_is_read_whatever_the_command_is_called(
    command: str, pid: int, start_time: int, state: str
) -> None:
    fields = [state, "1", "22", "33", *["0"] * 15, str(start_time), *["0"] * 30]
    stat = parse_stat(f"{pid} ({command}) {' '.join(fields)}\n")
    assert stat == ProcessStat(pid, command, state, 1, 22, 33, start_time)
    assert stat.is_alive == (state not in "ZX")


@pytest.mark.parametrize("text", ["", "12", "12 (a b", "12 (a) S 1 2", "x (a) S" + " 1" * 40])
def test_what_is_no_stat_is_refused(text: str) -> None:
    with pytest.raises(StatFormatError):
        parse_stat(text)


def test_a_zombie_exists_and_is_not_alive() -> None:
    process = subprocess.Popen(python("pass"))
    identity = read_stat(process.pid).identity
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    assert identity.exists()
    assert not identity.is_alive()
    process.wait()
    assert not identity.exists()
    with pytest.raises(NoSuchProcessError, match=str(process.pid)):
        read_stat(process.pid)


def test_a_handle_never_means_the_next_owner_of_a_pid() -> None:
    process = subprocess.Popen(["sleep", "600"])
    identity = read_stat(process.pid).identity
    with pytest.raises(NoSuchProcessError):
        ProcessHandle.open(ProcessIdentity(identity.pid, identity.start_time + 1))
    with ProcessHandle.open(identity) as handle:
        assert handle.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
        assert not handle.send_signal(signal.SIGKILL)
    with pytest.raises(NoSuchProcessError):
        ProcessHandle.open(identity)


def test_processes_that_proc_hides_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """As with ``mount -o hidepid=1``, where the processes of other users can be listed only."""
    opened = os.open

    def hiding(path: str, flags: int) -> int:
        if path == "/proc/1/stat":
            raise PermissionError(errno.EPERM, "Operation not permitted", path)
        return opened(path, flags)

    monkeypatch.setattr(os, "open", hiding)
    pids = {stat.pid for stat in list_processes()}
    assert os.getpid() in pids
    assert 1 not in pids


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


def test_a_sleeping_process_wants_no_processor(start: Callable[[str], int]) -> None:
    pid = start("sleeper")
    while processor_wait(pid, {"sleeper"}).wants_one:  # it has not come to its sleep yet
        os.sched_yield()
    assert processor_wait(pid, {"sleeper"}).wants_one is False


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
