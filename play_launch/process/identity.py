"""Which process is meant: a pid together with its start time, and a pidfd to act on it.

The kernel reuses a pid as soon as its process was waited for. The start time
distinguishes the two, and a pidfd never means the other one.
"""

from __future__ import annotations

import os
import signal
from typing import Self

from msgspec import Struct

_ZOMBIE_STATES = frozenset("ZXx")


class NoSuchProcessError(Exception):
    """The process meant does not exist (any more)."""

    def __init__(self, pid: int) -> None:
        super().__init__(f"there is no process {pid}, or its pid has a new owner")
        self.pid = pid


class StatFormatError(ValueError):
    """What was read is no `/proc/<pid>/stat`."""

    def __init__(self, text: str) -> None:
        super().__init__(f"not the stat of a process: {text[:80]!r}")


class ProcessStat(Struct, frozen=True):
    """The fields of `/proc/<pid>/stat` (see proc_pid_stat(5)) that matter to a supervisor.

    `start_time` is field 22: clock ticks after boot.
    """

    pid: int
    command: str
    state: str
    parent: int
    group: int
    session: int
    start_time: int

    @property
    def is_alive(self) -> bool:
        """Whether it still runs; a zombie only waits to be reaped."""
        return self.state not in _ZOMBIE_STATES

    @property
    def identity(self) -> ProcessIdentity:
        """The process this describes."""
        return ProcessIdentity(self.pid, self.start_time)


class ProcessIdentity(Struct, frozen=True):
    """One process for all time: pid and start time in clock ticks after boot."""

    pid: int
    start_time: int

    def exists(self) -> bool:
        """Whether this very process still has its pid, be it as a zombie."""
        try:
            return read_stat(self.pid).start_time == self.start_time
        except NoSuchProcessError:
            return False

    def is_alive(self) -> bool:
        """Whether this very process still runs (a zombie does not)."""
        try:
            stat = read_stat(self.pid)
        except NoSuchProcessError:
            return False
        return stat.start_time == self.start_time and stat.is_alive


def parse_stat(text: str) -> ProcessStat:
    """Read the content of `/proc/<pid>/stat`.

    The second field, the command, stands in parentheses and may itself hold spaces, parentheses
    and line ends, so the fields are counted from the last closing parenthesis.

    Raises:
        StatFormatError: Where fields are missing or are no numbers.
    """
    opening = text.find("(")
    closing = text.rfind(")")
    if opening < 0 or closing < opening:
        raise StatFormatError(text)
    fields = text[closing + 1 :].split()
    try:
        return ProcessStat(
            pid=int(text[:opening]),
            command=text[opening + 1 : closing],
            state=fields[0],
            parent=int(fields[1]),
            group=int(fields[2]),
            session=int(fields[3]),
            start_time=int(fields[19]),
        )
    except (ValueError, IndexError):
        raise StatFormatError(text) from None


def read_stat(pid: int) -> ProcessStat:
    """Read `/proc/<pid>/stat`; the kernel answers from memory, so this does not block.

    Raises:
        NoSuchProcessError: No process has this pid.
    """
    return parse_stat(_read(pid, "stat"))


def _read(pid: int, name: str) -> str:
    try:
        descriptor = os.open(f"/proc/{pid}/{name}", os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except (FileNotFoundError, ProcessLookupError):
        raise NoSuchProcessError(pid) from None
    try:
        return os.read(descriptor, 4096).decode(errors="replace")
    except ProcessLookupError:
        raise NoSuchProcessError(pid) from None
    finally:
        os.close(descriptor)


def tracer_of(pid: int) -> str:
    """Name what traces a process, such as "gdb (pid 12)"; empty: nothing, or it may not be read."""
    try:
        status = _read(pid, "status")
        tracer = int(status.partition("\nTracerPid:")[2].split(maxsplit=1)[0])
        return f"{read_stat(tracer).command} (pid {tracer})" if tracer else ""
    except (NoSuchProcessError, PermissionError, IndexError):
        return ""


def ancestors_of(pid: int) -> set[int]:
    """Its parent, the parent of that, and so on, as far as they can be seen."""
    found: set[int] = set()
    try:
        while pid > 1:
            pid = read_stat(pid).parent
            found.add(pid)
    except (NoSuchProcessError, PermissionError):
        pass
    return found | {1}


def list_processes() -> list[ProcessStat]:
    """Every process visible in `/proc`, zombies included. Takes about 20 us per process.

    Those of other users are left out where `/proc` is mounted with hidepid.
    """
    stats = []
    for name in os.listdir("/proc"):  # noqa: PTH208 (a Path for each entry doubles the time)
        if name.isdecimal():
            try:
                stats.append(read_stat(int(name)))
            except (NoSuchProcessError, PermissionError):
                continue
    return stats


class ProcessHandle:
    """A pidfd on a process that need not be our child; close it, or use it as a context."""

    def __init__(self, identity: ProcessIdentity, pidfd: int) -> None:
        self.identity = identity
        self._pidfd = pidfd

    @classmethod
    def open(cls, identity: ProcessIdentity) -> Self:
        """Open the very process meant.

        Raises:
            NoSuchProcessError: It has exited, or its pid belongs to another process.
            OSError: EMFILE and the like.
        """
        try:
            pidfd = os.pidfd_open(identity.pid)
        except ProcessLookupError:
            raise NoSuchProcessError(identity.pid) from None
        # Checked after opening: from here on the pidfd cannot change its meaning.
        if not identity.exists():
            os.close(pidfd)
            raise NoSuchProcessError(identity.pid)
        return cls(identity, pidfd)

    def fileno(self) -> int:
        """The pidfd; readable once the process has ended."""
        return self._pidfd

    def send_signal(self, number: signal.Signals) -> bool:
        """Send a signal; False when the process has gone."""
        try:
            signal.pidfd_send_signal(self._pidfd, number)
        except ProcessLookupError:
            return False
        return True

    def close(self) -> None:
        """Close the pidfd; may be called twice."""
        pidfd, self._pidfd = self._pidfd, -1
        if pidfd >= 0:
            os.close(pidfd)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"ProcessHandle(pid={self.identity.pid}, start_time={self.identity.start_time})"
