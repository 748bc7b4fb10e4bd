"""Waits of threads for a processor, and in the kernel, from ``/proc/<pid>/task``."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Collection

    from play_launch.process.identity import ProcessIdentity

_MOST: Final = 4096
"""Bytes; none of the files is longer."""
_WANTING: Final = frozenset("RD")
"""States of proc_pid_stat(5): ready to run or running, and waiting for a disk, as for swapped
memory."""
_TRACED: Final = "t"
"""The state of a thread that a debugger has stopped."""


class ProcessorWait(NamedTuple):
    """How long threads have waited for a processor."""

    seconds: float
    """Up to when they were given one last, since they began."""
    wants_one: bool
    """Whether one of them runs or waits for a processor now; `seconds` lacks that wait."""
    is_traced: bool = False
    """Whether a debugger has stopped one of them."""


def own_wait() -> ProcessorWait:
    """Say it of the calling thread, which has one now."""
    try:
        return ProcessorWait(_waited("/proc/thread-self"), wants_one=False)
    except OSError:
        return ProcessorWait(0.0, wants_one=False)


def processor_wait(pid: int, threads: Collection[str]) -> ProcessorWait:
    """Say it of the threads of a process that have one of these names; of none: no wait at all.

    Kernels that do not count it (``/proc/<pid>/schedstat``) give 0 seconds.
    """
    seconds, wants_one, is_traced = 0.0, False, False
    try:
        for thread in os.listdir(f"/proc/{pid}/task"):  # noqa: PTH208 (as in identity.py)
            folder = f"/proc/{pid}/task/{thread}"
            try:
                name, _, fields = _read(folder, "stat").partition("(")[2].rpartition(")")
                if name in threads:
                    state = fields.split()[0]
                    wants_one |= state in _WANTING
                    is_traced |= state == _TRACED
                    seconds += _waited(folder)
            except (FileNotFoundError, ProcessLookupError, IndexError):  # it has ended since
                continue
    except OSError:
        pass
    return ProcessorWait(seconds, wants_one, is_traced)


def thread_wait(process: ProcessIdentity, thread_name: str) -> str:
    """Describe the kernel function in which a thread waits; empty if it runs or is not readable.

    Without a name, the main thread is meant.
    """
    try:
        for thread in os.listdir(f"/proc/{process.pid}/task"):  # noqa: PTH208 (as in identity.py)
            folder = f"/proc/{process.pid}/task/{thread}"
            is_main = not thread_name and int(thread) == process.pid
            if is_main or (thread_name and _read(folder, "comm").rstrip("\n") == thread_name):
                function = _read(folder, "wchan")
                # Last: until here the pid was still that of this process.
                is_known = function not in {"", "0"} and process.is_alive()
                return f"waits in {function} of the kernel" if is_known else ""
    except OSError:  # it has exited, or is another user's
        pass
    return ""


def _waited(folder: str) -> float:
    # Documentation/scheduler/sched-stats.rst: nanoseconds on a processor, waiting for one, turns.
    fields = _read(folder, "schedstat").split()
    return int(fields[1]) / 1e9 if len(fields) > 1 else 0.0


def _read(folder: str, name: str) -> str:
    """Read one file; the kernel answers from memory, so this does not block."""
    descriptor = os.open(f"{folder}/{name}", os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    try:
        return os.read(descriptor, _MOST).decode(errors="replace")
    finally:
        os.close(descriptor)
