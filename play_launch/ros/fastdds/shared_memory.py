"""Removes what killed processes left of Fast DDS's shared memory.

Fast DDS 2.14 (the RMW of ROS 2 Jazzy) keeps these files in `/dev/shm`; from version 3 on (Kilted)
their names have `fastdds_` in place of `fastrtps_`:

- `fastrtps_<16 hex digits>`: the data of one participant. The lock file `..._el` is locked with
  flock(2) from before the segment is made until its owner ends.
- `fastrtps_port<N>`: the queue of one receiver, mapped by every sender, too. Its receiver holds a
  lock on `..._el` (one receiver) or `..._sl` (several).
- `sem.fastrtps_port<N>_mutex`: a POSIX semaphore that is held while a process opens or removes
  that port.

The kernel releases the locks of a killed process and leaves its files, which then fill the memory
and break the next process with the same port number. Fast DDS itself takes a port whose
lock file is there and unlocked for dead, and resets it; so do we. A port without any lock file
(its sender opened it anew, or its receiver ended well while the count of users had been spoilt by
a killed one) is dead when no process maps it.

A port is judged and removed while we hold its semaphore, so none can be opened meanwhile, and
every lock is held until its file is gone. A participant that is just being created loses the race
for its lock at worst: it then takes the next random number, as Fast DDS provides for.

Its senders map a port beyond its removal. They notice that it is dead only if its receiver was
killed while it waited or worked on a message. Killed between the two it looks healthy for ever:
the senders fill it, and do not look for the port that a new process makes under the same number.
So such a port is marked as broken, as Fast DDS marks it, before it is removed. Others are not: a
sender that has given one up makes its file anew at each message, which a new process may run into.
"""

from __future__ import annotations

import asyncio
import ctypes
import errno
import fcntl
import os
import re
import struct
import sys
import threading
import time
from contextlib import ExitStack, contextmanager, suppress
from enum import Enum
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct, field

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 (where Linux keeps shared memory)

_LONGEST_WAIT: Final = 2.0
"""Seconds that one sweep waits for another one; usually it is some milliseconds."""
_BETWEEN_TRIES: Final = 0.005
_LONGEST_READ: Final = 2.0
"""Seconds in which what all processes map is read; usually it is some milliseconds."""
_SEGMENT = re.compile(r"(fast(?:rtps|dds)_[0-9a-f]{16})(?:_el)?")
_PORT = re.compile(r"(?:sem\.)?(fast(?:rtps|dds)_port\d+)(?:_el|_sl|_mutex)?")
_IS_THEIRS = re.compile(r"(?:sem\.)?fast(?:rtps|dds)_")


class SweepReport(Struct):
    """What a sweep found.

    Attributes:
        removed: Names of the files that are gone now.
        in_use: How many participants' segments and ports living processes hold.
        failed: Names of dead files that could not be removed, with the reason.
    """

    removed: list[str] = field(default_factory=list)
    in_use: int = 0
    failed: dict[str, str] = field(default_factory=dict)


class FileCount(Struct, frozen=True):
    """How many files there are.

    Attributes:
        files: Of the living and of the dead.
        leftovers: Lock files whose owner is dead.
    """

    files: int
    leftovers: int


def count_files(folder: Path = SHARED_MEMORY) -> FileCount:
    """Count without changing anything; raises OSError where the folder cannot be read."""
    names = [path.name for path in folder.iterdir() if _IS_THEIRS.match(path.name)]
    locks = [name for name in names if name.endswith(("_el", "_sl"))]
    return FileCount(len(names), sum(_is_left(folder / name) for name in locks))


async def sweep_shared_memory() -> SweepReport:
    """Run `sweep` in a thread."""
    return await asyncio.to_thread(sweep)


def sweep() -> SweepReport:
    """Remove the segments and ports that no living process holds.

    Takes a few milliseconds, with leftovers about one more per process of the machine. Processes
    of other users cannot be looked into; where they hold a lock, that is respected all the same.
    Nor can those that are stuck in the kernel: then what has no lock file stays.
    """
    report = SweepReport()
    with _turn():
        names = _names()
        segments = {match[1] for name in names if (match := _SEGMENT.fullmatch(name))}
        ports = {match[1] for name in names if (match := _PORT.fullmatch(name))}
        for name in sorted(segments):
            _sweep_segment(name, report)
        _sweep_ports(sorted(ports), report)
    return report


@contextmanager
def _turn() -> Iterator[None]:
    """Let one sweep of the machine be at work at a time: two take each other for users of a port.

    After the timeout it continues; then something stays until the next sweep.
    """
    folder = os.open(SHARED_MEMORY, os.O_RDONLY | os.O_CLOEXEC | os.O_DIRECTORY)
    try:
        deadline = time.monotonic() + _LONGEST_WAIT
        while time.monotonic() < deadline:
            try:
                fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                time.sleep(_BETWEEN_TRIES)
            else:
                break
        yield
    finally:
        os.close(folder)


def _sweep_segment(name: str, report: SweepReport) -> None:
    with ExitStack() as held:
        lock = f"{name}_el"
        state = _take_lock(SHARED_MEMORY / lock, held)
        if state is _Lock.ABSENT and _Mappings().users(name):
            state = _Lock.BUSY
        if state is _Lock.ABSENT and (SHARED_MEMORY / lock).exists():
            state = _Lock.BUSY  # the lock is made first: a new owner has just come
        if state is _Lock.BUSY:
            report.in_use += 1
            return
        _remove(name, report)
        _remove(lock, report)


class _Port:
    """One port that is being judged."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.semaphore = f"sem.{name}_mutex"
        # None: held, maybe by a dead process. False: out of our reach.
        self._mutex: bool | None = None
        self._locks: set[_Lock] = set()

    @property
    def is_suspect(self) -> bool:
        """Whether it may be dead, as far as can be known without reading the maps of processes."""
        return self._mutex is None or (self._mutex and _Lock.BUSY not in self._locks)

    def take(self, held: ExitStack) -> None:
        """Lock what a process opening it would hold, and what its receiver would hold."""
        with ExitStack() as taken:
            try:
                self._mutex = True if _take_semaphore(self.semaphore, taken) else None
            except OSError:  # it belongs to another user
                self._mutex = False
                return
            if self._mutex:
                self._take_locks(taken)
            # That of a living port is given back at once.
            if self.is_suspect:
                held.push(taken.pop_all())

    def is_dead(self, mapped: _Mappings, held: ExitStack) -> bool:
        """Whether no living process holds it; `mapped` was found after `take`."""
        if self._mutex is None:
            # A process is opening it, or died while doing so: all later ones wait for 20 s
            # then. We map the semaphore ourselves, just for having opened it.
            us = os.getpid()
            here = any(us in mapped.users(name) for name in _names() if _SEGMENT.fullmatch(name))
            if mapped.users(self.semaphore) - {us} or here:
                return False
            self._take_locks(held)
        if not self.is_suspect or _Lock.BUSY in self._locks:
            return False
        return _Lock.TAKEN in self._locks or not mapped.users(self.name)

    def remove(self, mapped: _Mappings, report: SweepReport) -> None:
        """Remove its files; a semaphore with waiting processes stays."""
        _mark_broken(SHARED_MEMORY / self.name)
        for name in (self.name, f"{self.name}_el", f"{self.name}_sl"):
            _remove(name, report)
        if not mapped.users(self.semaphore) - {os.getpid()}:
            _remove(self.semaphore, report)

    def _take_locks(self, held: ExitStack) -> None:
        paths = [SHARED_MEMORY / f"{self.name}{suffix}" for suffix in ("_el", "_sl")]
        self._locks = {_take_lock(path, held) for path in paths}


_PORT_STATE: Final = struct.Struct("=7I")
"""Of `PortNode` in `SharedMemGlobal.hpp`, the same in Fast DDS 2.14 and 3: the port's number, how
many listeners, milliseconds of the health check and of a wait, capacity, how many wait, flags."""
_STATE_IS_BEFORE: Final = 4096
_MOST_LISTENERS: Final = 1024
_IS_OK: Final = 1


def _mark_broken(port: Path) -> None:
    """Tell all senders to give a port up on which none waits; another layout stays as it is."""
    number = int(re.sub(r"\D+", "", port.name))
    # Missing, or of another user.
    with suppress(OSError), port.open("r+b", buffering=0) as file:
        head = file.read(_STATE_IS_BEFORE)
        for start in range(0, len(head) - _PORT_STATE.size + 1, 4):
            found, listeners, check, wait, capacity, waits, flags = _PORT_STATE.unpack_from(
                head, start
            )
            if (
                (found, wait) == (number, check // 3)
                and listeners <= _MOST_LISTENERS
                and capacity > 0
                and flags & _IS_OK
            ):
                if waits:  # its senders find out by themselves, and not all at the next message
                    return
                file.seek(start + _PORT_STATE.size - 4)
                file.write(struct.pack("=I", flags & ~_IS_OK))
                return


def _sweep_ports(names: list[str], report: SweepReport) -> None:
    with ExitStack() as held:
        ports = [_Port(name) for name in names]
        for port in ports:
            port.take(held)
        suspects = [port for port in ports if port.is_suspect]
        report.in_use += len(ports) - len(suspects)
        # Read only now: later processes wait for a semaphore that we hold.
        mapped = _Mappings(None if suspects else [])
        for port in suspects:
            if port.is_dead(mapped, held):
                port.remove(mapped, report)
            else:
                report.in_use += 1


class _Lock(Enum):
    """Result of the attempt to lock a file."""

    TAKEN = "taken"
    BUSY = "busy"
    ABSENT = "absent"


def _take_lock(path: Path, held: ExitStack) -> _Lock:
    """Lock a lock file as its owner would, until `held` is closed; never create it."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    except FileNotFoundError:
        return _Lock.ABSENT
    except OSError:
        return _Lock.BUSY  # nothing of ours: let it be
    with ExitStack() as opened:
        opened.callback(os.close, descriptor)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return _Lock.BUSY
        # It may have been removed, and made again by another process, before we had the lock.
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), path.stat()):
                held.push(opened.pop_all())
                return _Lock.TAKEN
    return _Lock.BUSY


def _take_semaphore(name: str, held: ExitStack) -> bool:
    """Take a port's semaphore until `held` is closed; make it where it is missing.

    Returns whether we have it.

    Raises OSError when it cannot be opened, or was removed while we did.
    """
    posix_name = name.removeprefix("sem.")
    libc = _libc()
    semaphore = libc.sem_open(f"/{posix_name}".encode(), os.O_CREAT, 0o644, 1)
    if not semaphore:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), name)
    # The semaphore is unmapped only when `held` is closed: until then no process that looks for
    # dead holders takes us for none.
    held.callback(libc.sem_close, semaphore)
    if libc.sem_trywait(semaphore) != 0:
        return False
    held.callback(libc.sem_post, semaphore)
    if os.getpid() not in _Mappings(["self"]).users(name):
        raise OSError(errno.ESTALE, "the semaphore was removed meanwhile", name)
    return True


@cache
def _libc() -> ctypes.CDLL:
    libc = ctypes.CDLL(None, use_errno=True)
    libc.sem_open.restype = ctypes.c_void_p
    for function in (libc.sem_trywait, libc.sem_post, libc.sem_close):
        function.argtypes = [ctypes.c_void_p]
    return libc


class _Mappings:
    """Which processes map which files of `/dev/shm`, at the time this is made.

    Files are identified by their inodes. The names in `/proc/<pid>/maps` are of no use: glibc makes
    a semaphore under a temporary name, and its maker shows that name, deleted, until it exits.
    """

    def __init__(self, processes: Iterable[str] | None = None) -> None:
        """Look at `processes` (pids, or `self`), or at all, as far as they can be looked into."""
        device = SHARED_MEMORY.stat().st_dev
        mapping = re.compile(
            rb" %02x:%02x (\d+) +/" % (os.major(device), os.minor(device))  # as proc_pid_maps(5)
        )
        self._users: dict[int, set[int]] = {}
        self._is_complete = True
        if processes is not None:
            self._read(processes, mapping)
            return
        every = [path.name for path in Path("/proc").iterdir() if path.name.isdecimal()]
        self._is_complete = _ends_in_time(partial(self._read, every, mapping))

    def _read(self, processes: Iterable[str], mapping: re.Pattern[bytes]) -> None:
        for process in processes:
            pid = os.getpid() if process == "self" else int(process)
            # Gone meanwhile, a kernel thread, or a process of another user.
            with suppress(OSError):
                for match in mapping.finditer(Path(f"/proc/{process}/maps").read_bytes()):
                    self._users.setdefault(int(match[1]), set()).add(pid)

    def users(self, name: str) -> set[int]:
        """Return the pids of processes that map the file that has this name now."""
        try:
            found = self._users.get((SHARED_MEMORY / name).stat().st_ino, set())
        except FileNotFoundError:
            return set()
        return set(found) if self._is_complete else {_MAYBE, *found}


_MAYBE: Final = 0
"""The pid of a process that may map any file, as it cannot be looked into."""
_stuck_reader: threading.Thread | None = None


def _ends_in_time(read: Callable[[], None]) -> bool:
    """Read what processes map, in a thread that the end of the program does not wait for.

    The kernel keeps a reader waiting while the process itself waits with its page tables locked, as
    for the disk of a dead server: maybe without end. As long as one waits, no other is begun.
    """
    global _stuck_reader  # noqa: PLW0603 - it is the kernel's state, and one for all
    if _stuck_reader is not None and _stuck_reader.is_alive():
        return False
    reader = threading.Thread(target=read, name="maps", daemon=True)
    reader.start()
    reader.join(_LONGEST_READ)
    _stuck_reader = reader if reader.is_alive() else None
    return _stuck_reader is None


def _names() -> list[str]:
    return [path.name for path in SHARED_MEMORY.iterdir()]


def _remove(name: str, report: SweepReport) -> None:
    try:
        (SHARED_MEMORY / name).unlink()
    except FileNotFoundError:
        return
    except OSError as error:
        report.failed[name] = error.strerror or str(error)
    else:
        report.removed.append(name)


def _is_left(lock: Path) -> bool:
    """Whether no process holds the lock that the owner of a segment holds for all of its life."""
    with ExitStack() as held:
        if _take_lock(lock, held) is not _Lock.TAKEN:
            return False
    # A receiver that shares its port holds the other lock with others, so that ours is no proof.
    return lock.name.endswith("_el") and not lock.with_name(f"{lock.name[:-3]}_sl").exists()


def sweep_command() -> list[str]:
    """Return the command that sweeps after the supervisor's exit, in its environment."""
    # -P: the working directory is not trusted.
    return [sys.executable, "-P", "-m", "play_launch.ros.fastdds"]
