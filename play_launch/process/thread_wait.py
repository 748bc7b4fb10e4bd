"""What a thread waits for, in words, as the kernel shows it in ``/proc`` (see proc_pid_syscall(5)).

The thread is not touched: it gets no signal, and its system call is not interrupted. It needs the
right to trace the process, which the kernel gives for processes of the same user, or of those
below us where Yama's ``ptrace_scope`` is 1.
"""

from __future__ import annotations

import os
import platform
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from play_launch.process.identity import ProcessIdentity


_NAMES: Final = {
    "x86_64": {
        0: "read",
        1: "write",
        7: "poll",
        16: "ioctl",
        23: "select",
        35: "nanosleep",
        42: "connect",
        43: "accept",
        45: "recvfrom",
        47: "recvmsg",
        61: "wait4",
        72: "fcntl",
        73: "flock",
        202: "futex",
        230: "clock_nanosleep",
        232: "epoll_wait",
        247: "waitid",
        257: "openat",
        270: "pselect6",
        271: "ppoll",
        281: "epoll_pwait",
        288: "accept4",
    },
    "aarch64": {
        22: "epoll_pwait",
        25: "fcntl",
        29: "ioctl",
        32: "flock",
        56: "openat",
        63: "read",
        64: "write",
        72: "pselect6",
        73: "ppoll",
        95: "waitid",
        98: "futex",
        101: "nanosleep",
        115: "clock_nanosleep",
        202: "accept",
        203: "connect",
        207: "recvfrom",
        212: "recvmsg",
        242: "accept4",
        260: "wait4",
    },
}
"""Those that programs wait in; from asm/unistd.h of each machine."""

_ON_DESCRIPTORS: Final = frozenset(
    {"accept", "accept4", "connect", "fcntl", "flock", "ioctl", "read", "recvfrom", "recvmsg"}
    | {"write"}
)
_FUTEX_PRIVATE: Final = 128
"""FUTEX_PRIVATE_FLAG of linux/futex.h."""
_MOST: Final = 4096
"""Bytes; none of the files is longer."""


class SystemCall(NamedTuple):
    """A system call that a thread is in."""

    number: int
    arguments: tuple[int, ...]
    """All six, as they are in the registers."""


def parse_system_call(text: str) -> SystemCall | None:
    """Read ``/proc/<pid>/task/<tid>/syscall``; None: the thread is in none, or runs."""
    fields = text.split()
    try:
        number = int(fields[0])
        arguments = tuple(int(field, 16) for field in fields[1:7])
    except (ValueError, IndexError):
        return None
    return SystemCall(number, arguments) if number >= 0 and len(arguments) == 6 else None


def described(call: SystemCall, machine: str) -> str:
    """Say what somebody in this system call waits for, on this machine (`platform.machine()`)."""
    name = _NAMES.get(machine, {}).get(call.number, "")
    if not name:
        return f"is in system call {call.number}"
    if name == "futex":
        is_private = call.arguments[1] & _FUTEX_PRIVATE
        whose = "of its process" if is_private else "that processes share"
        return f"waits for a lock, condition or semaphore {whose} (futex)"
    if name in _ON_DESCRIPTORS:
        return f"waits in {name} of descriptor {call.arguments[0] & 0xFFFFFFFF}"
    return f"waits in {name}"


def thread_wait(process: ProcessIdentity, thread_name: str) -> str:
    """Say what the thread with this name waits for; empty: there is none, it runs, or is hidden.

    Without a name, the first thread of the process is meant.
    """
    try:
        thread = _thread_named(process.pid, thread_name) if thread_name else process.pid
        call = parse_system_call(_read(process.pid, thread, "syscall")) if thread else None
    except OSError:  # it has gone, or may not be read
        return ""
    # Last: until here the pid was still that of this process.
    if call is None or not process.is_alive():
        return ""
    return described(call, platform.machine())


def _thread_named(pid: int, name: str) -> int:
    """Find it; 0 where there is none. A list of threads comes from memory as well."""
    for thread in os.listdir(f"/proc/{pid}/task"):  # noqa: PTH208 (as in identity.py)
        try:
            if _read(pid, int(thread), "comm").rstrip("\n") == name:
                return int(thread)
        except (FileNotFoundError, ProcessLookupError):  # it has ended since
            continue
    return 0


def _read(pid: int, thread: int, name: str) -> str:
    """Read one file; the kernel answers from memory, so this does not block."""
    path = f"/proc/{pid}/task/{thread}/{name}"
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    try:
        return os.read(descriptor, _MOST).decode(errors="replace")
    finally:
        os.close(descriptor)
