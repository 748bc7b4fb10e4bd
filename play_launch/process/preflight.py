"""What a machine has to offer before anything is started, and what it lacks, in words."""

from __future__ import annotations

import os
import resource
import signal
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from msgspec import Struct

if TYPE_CHECKING:
    from play_launch.process.exit import Exit

LEAST_ADDRESS_SPACE: Final = 1024**3
"""Bytes. With less, threads and libraries of ROS do not fit into a process with one node."""
_PROC_FIX: Final = "mount -t proc proc /proc, in the PID namespace of play-launch"
ADDRESS_SPACE_FIX: Final = "ulimit -v unlimited, or LimitAS=infinity in the systemd unit"
SHARED_MEMORY_FIX: Final = "in docker: --shm-size 1g; else mount -o remount,size=1g /dev/shm"
_SHARED_MEMORY: Final = "/dev/shm"  # noqa: S108 - where Linux keeps shared memory
_PAGES: Final = 64 * 1024
_FULL: Final = 1024**2
"""Bytes. Less than a segment of Fast DDS."""
_MEBIBYTE: Final = 1024**2


class Room(Struct, frozen=True):
    """The size of a file system and what is free of it, in bytes."""

    total: int
    free: int

    def __str__(self) -> str:
        return f"{mebibytes(self.free)} of {mebibytes(self.total)} free"


def proc_problem() -> str:
    """Return why `/proc` does not show this process, and the fix; empty if it does."""
    try:
        shown = os.readlink("/proc/self")  # noqa: PTH115 - a Path would only be made a text again
    except OSError:
        return f"/proc is not mounted, or not the one of this PID namespace; fix: {_PROC_FIX}"
    if shown != str(os.getpid()):
        problem = f"/proc belongs to another PID namespace: it shows this process as {shown}"
        return f"{problem}; fix: {_PROC_FIX}"
    return ""


def address_space_problem() -> str:
    """Report an address space that is too small for any process with ROS; empty: it is not."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY or limit >= LEAST_ADDRESS_SPACE:
        return ""
    least = mebibytes(LEAST_ADDRESS_SPACE)
    return (
        f"the address space of a process is limited to {mebibytes(limit)} (ulimit -v), "
        f"and one with ROS needs {least} or more; fix: {ADDRESS_SPACE_FIX}"
    )


def shared_memory_room() -> Room | None:
    """Return the room in `/dev/shm`; None without it."""
    try:
        found = os.statvfs(_SHARED_MEMORY)
    except OSError:
        return None
    return Room(total=found.f_blocks * found.f_frsize, free=found.f_bavail * found.f_frsize)


def shared_memory_problem(participants: int) -> str:
    """Report shared memory too small for so many participants of Fast DDS; empty: it is not.

    Each takes half a megabyte, and the queues of its ports about as much.
    """
    room, least = shared_memory_room(), max(16, participants) * _MEBIBYTE
    if room is None or room.free >= least:
        return ""
    return (
        f"{_SHARED_MEMORY} has {room}, this system needs {mebibytes(least)} or more: processes "
        f"can die of SIGBUS, and messages can be lost; fix: {SHARED_MEMORY_FIX}"
    )


def full_shared_memory() -> str:
    """Report that no process with ROS can start, because shared memory is full; empty: it is not.

    rcl's tracing, lttng-ust, maps a page of it in each process, and dies of SIGBUS without one, in
    a thread that no handler reaches. Fast DDS allocates what it maps beforehand, and does without
    shared memory where that fails.
    """
    room = shared_memory_room()
    if room is None or room.free >= _PAGES:
        return ""
    return (
        f"{_SHARED_MEMORY} is full ({room}): every process with ROS dies of SIGBUS there; fix: "
        f"{SHARED_MEMORY_FIX}"
    )


def explained(exit_: Exit) -> Exit:
    """Add to a death of SIGBUS that shared memory is full, where it is."""
    if exit_.signal != signal.SIGBUS:
        return exit_
    return replace(exit_, hint=bus_error_hint(shared_memory_room()))


def bus_error_hint(room: Room | None) -> str:
    """Say that shared memory is full; empty: it is not."""
    if room is None or room.free >= _FULL:
        return ""
    return f"{_SHARED_MEMORY} is full ({room}); fix: {SHARED_MEMORY_FIX}"


def mebibytes(size: int) -> str:
    """Write a number of bytes."""
    return f"{size / _MEBIBYTE:,.0f} MiB"
