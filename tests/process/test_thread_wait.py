"""What a thread waits for, read from the kernel."""

from __future__ import annotations

import ctypes
import mmap
import os
import platform
import signal
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.process.identity import ProcessIdentity, read_stat
from play_launch.process.thread_wait import (
    SystemCall,
    described,
    parse_system_call,
    thread_wait,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

SEM_T = 32
"""Bytes of a sem_t; it holds more nowhere."""
LIBC = ctypes.CDLL(None)
NO_ARGUMENTS = (0,) * 6


@given(st.integers(0, 500), st.lists(st.integers(0, 2**64 - 1), min_size=6, max_size=6))
def test_a_system_call_is_read_as_the_kernel_writes_it(number: int, arguments: list[int]) -> None:
    text = f"{number} {' '.join(map(hex, arguments))} 0x7ffd 0x7f01\n"
    assert parse_system_call(text) == SystemCall(number, tuple(arguments))


@pytest.mark.parametrize("text", ["running\n", "-1 0x7ffd6b 0x7f01\n", "", "202 0x1"])
def test_a_thread_outside_of_system_calls_is_in_none(text: str) -> None:
    assert parse_system_call(text) is None


@given(st.text())
def test_nothing_else_is_mistaken_for_one(text: str) -> None:
    parse_system_call(text)


@pytest.mark.parametrize(
    ("machine", "number", "arguments", "words"),
    [
        ("x86_64", 202, (1, 0), "waits for a lock, condition or semaphore that processes share"),
        ("x86_64", 202, (1, 137), "waits for a lock, condition or semaphore of its process"),
        ("aarch64", 98, (1, 128), "waits for a lock, condition or semaphore of its process"),
        ("x86_64", 0, (7,), "waits in read of descriptor 7"),
        ("aarch64", 115, (), "waits in clock_nanosleep"),
        ("x86_64", 499, (), "is in system call 499"),
        ("riscv64", 98, (), "is in system call 98"),
    ],
)
def test_words(machine: str, number: int, arguments: tuple[int, ...], words: str) -> None:
    call = SystemCall(number, (*arguments, *NO_ARGUMENTS)[:6])
    assert described(call, machine).startswith(words)


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


@pytest.mark.skipif(platform.machine() not in {"x86_64", "aarch64"}, reason="names of system calls")
def test_being_asked_does_no_harm(semaphore: int) -> None:
    process = forked(b"load-7", lambda: LIBC.sem_wait(ctypes.c_void_p(semaphore)))
    try:
        until_asleep(process, "load-7")
        said = {thread_wait(process, name) for name in ("", "load-7") for _ in range(100)}
        other = thread_wait(process, "load-8")
        LIBC.sem_post(ctypes.c_void_p(semaphore))
        assert os.waitpid(process.pid, 0)[1] == 0
    except BaseException:
        os.kill(process.pid, signal.SIGKILL)
        os.waitpid(process.pid, 0)
        raise
    assert said == {"waits for a lock, condition or semaphore that processes share (futex)"}
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
