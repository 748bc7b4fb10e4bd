"""What one process uses, from its folder in ``/proc`` (see proc(5)).

psutil gives the same numbers in five times the CPU time; see `docs/decisions/sampling.md`.
"""

from __future__ import annotations

import contextlib
import os
import time
from typing import Final, NamedTuple

_KIB: Final = 1024
_MOST: Final = 65536
"""Bytes; none of the files is longer."""
_ENDED: Final = (b"Z", b"X", b"x")


class ProcessUsage(NamedTuple):
    """What a process used since its start, and uses now."""

    start_time: int
    """Clock ticks after boot."""
    cpu_ns: int
    """User and system time of all of its threads, those that ended included."""
    rss: int
    """Bytes."""
    threads: int
    descriptors: int
    read_bytes: int
    """0 where the process is another user's."""
    write_bytes: int
    voluntary_switches: int
    """Of its main thread, as are the next."""
    involuntary_switches: int


class ProcessFiles:
    """The files of one process in ``/proc``, kept open.

    They stay those of this process, whoever gets its pid later. Reading them again takes half the
    time of opening, reading and closing.
    """

    def __init__(self, pid: int) -> None:
        """Open them.

        Raises:
            OSError: When the process is gone, or no descriptor is free.
        """
        self._status = self._io = -1
        # Whatever is opened by way of the folder is of the process that had the pid right now.
        folder = os.open(f"/proc/{pid}", os.O_RDONLY | os.O_DIRECTORY)
        try:
            self.pid = pid
            self.start_time = _start_time(read_file("stat", folder))
            """Clock ticks after boot."""
            self._status = os.open("status", os.O_RDONLY, dir_fd=folder)
            with contextlib.suppress(PermissionError):
                self._io = os.open("io", os.O_RDONLY, dir_fd=folder)
        except BaseException:
            self.close()
            raise
        finally:
            os.close(folder)

    def usage(self, *, shares_descriptors: bool = False) -> ProcessUsage | None:
        """Measure the process; None when it has ended.

        `shares_descriptors` leaves the descriptors at 0, as somebody else's are counted.
        """
        try:
            read_bytes, write_bytes = self._storage()
            descriptors = 0 if shares_descriptors else _descriptors(f"/proc/{self.pid}/fd")
            cpu_ns = time.clock_gettime_ns(_cpu_clock(self.pid))
            # Last: while it can be read, the pid is still that of this process.
            status = os.pread(self._status, _MOST, 0)
        except OSError:
            return None
        at = status.find(b"\nState:\t")
        if status[at + 8 : at + 9] in _ENDED:
            return None
        voluntary, involuntary = _neighbours(status, b"\nvoluntary_ctxt_switches:")
        return ProcessUsage(
            start_time=self.start_time,
            cpu_ns=cpu_ns,
            rss=(field(status, b"VmRSS:") or 0) * _KIB,
            threads=field(status, b"Threads:") or 0,
            descriptors=descriptors,
            read_bytes=read_bytes,
            write_bytes=write_bytes,
            voluntary_switches=voluntary,
            involuntary_switches=involuntary,
        )

    def close(self) -> None:
        """Let go of them; further calls do nothing."""
        for descriptor in (self._status, self._io):
            if descriptor >= 0:
                os.close(descriptor)
        self._status = self._io = -1

    def _storage(self) -> tuple[int, int]:
        if self._io < 0:
            return 0, 0
        try:
            return _neighbours(os.pread(self._io, _MOST, 0), b"\nread_bytes:")
        except PermissionError:  # it has become another user's
            return 0, 0

    def __del__(self) -> None:
        self.close()


def process_usage(pid: int, *, shares_descriptors: bool = False) -> ProcessUsage | None:
    """Measure a process once, as `ProcessFiles` does again and again."""
    try:
        files = ProcessFiles(pid)
    except OSError:
        return None
    try:
        return files.usage(shares_descriptors=shares_descriptors)
    finally:
        files.close()


def proportional_set_size(pid: int) -> int | None:
    """Return the PSS of a process in bytes; None when it has ended, or does not let us see it.

    The kernel walks all of its page tables: some 5 ms for a gigabyte.
    """
    try:
        text = read_file(f"/proc/{pid}/smaps_rollup")
    except OSError:
        return None
    value = field(text, b"Pss:")
    return None if value is None else value * _KIB


def read_file(path: str, folder: int | None = None) -> bytes:
    """Read a small file of the kernel in one system call, below an open folder if one is given.

    Raises:
        OSError: When it is not there, or may not be read.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC, dir_fd=folder)
    try:
        return os.read(descriptor, _MOST)
    finally:
        os.close(descriptor)


def field(text: bytes, name: bytes) -> int | None:
    """Return the number behind `name`, which is at the beginning of a line; None without one."""
    at = text.find(b"\n" + name)
    if at < 0:
        return None
    words = text[at + 1 + len(name) : at + 1 + len(name) + 64].split(None, 1)
    return int(words[0]) if words and words[0].isdigit() else None


def _neighbours(text: bytes, first: bytes) -> tuple[int, int]:
    """Return the numbers of a line, whose beginning is given, and of the next; 0 without any.

    Both lines are among the last of their file; this takes half the time of two fields.
    """
    at = text.rfind(first)
    words = text[at:].split(None, 4) if at >= 0 else []
    return (int(words[1]), int(words[3])) if len(words) > 3 else (0, 0)


def _cpu_clock(pid: int) -> int:
    # The process's CPU clock, as clock_getcpuclockid(3) makes it: nanoseconds, where the fields of
    # `stat` have hundredths of a second.
    return ~pid << 3 | 2


def _start_time(stat: bytes) -> int:
    # The command, in parentheses, may hold anything.
    return int(stat[stat.rindex(b")") + 2 :].split(None, 20)[19])


def _descriptors(folder: str) -> int:
    try:
        # From Linux 6.2 on, the size is their number; 0 before. Paths would double the time.
        return os.stat(folder).st_size or len(os.listdir(folder))  # noqa: PTH116, PTH208
    except PermissionError:
        return 0
