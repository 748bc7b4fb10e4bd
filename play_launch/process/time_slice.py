"""Turns on a processor that many others want, for processes whose work is short and waited for."""

from __future__ import annotations

import contextlib
import ctypes
import os
import struct
from pathlib import Path
from typing import Final

SLICE: Final = 100_000
"""ns; the shortest that Linux gives."""
NICE: Final = -10
"""Where it may be: nine turns for one of an ordinary program."""
_AUTOGROUP: Final = Path("/proc/self/autogroup")
_SYSTEM_CALL: Final = {"x86_64": 314, "aarch64": 274}
"""The number of sched_setattr(2), which neither Python nor older C libraries have."""
_RESET_ON_FORK: Final = 1
_AHEAD: Final = os.SCHED_RR | os.SCHED_RESET_ON_FORK
_LOWEST_PRIORITY: Final = 1
"""Of the real-time ones: nodes that have one themselves go first."""


def ask_for_short_turns(pid: int = 0, *, children_too: bool = True) -> bool:
    """Have a thread run for a short time but soon.

    An answer takes less than a millisecond of processor time. Where sixty starting or ending
    programs want two processors, whose turns are some milliseconds each, it waits for seconds. The
    scheduler of Linux 6.12 and later (EEVDF, "custom slice" in its sources) takes the one first
    whose time slice would end first, within its fair share, without privileges.

    Args:
        pid: A process, whose main thread it is; 0 is the calling thread.
        children_too: Whether threads and processes that it starts from now on have it as well. If
            not, these would lose a negative nice value, so that nothing is asked for then.

    Returns:
        Whether the kernel has taken it. Older kernels take it and go on as before, or refuse.
    """
    machine = os.uname().machine
    try:
        nice = os.getpriority(os.PRIO_PROCESS, pid)
        is_usual = os.sched_getscheduler(pid) == os.SCHED_OTHER
    except ProcessLookupError:
        return False
    if machine not in _SYSTEM_CALL or not is_usual or (nice < 0 and not children_too):
        return False
    # struct sched_attr: size, policy, flags, nice, priority, runtime, deadline, period.
    flags = 0 if children_too else _RESET_ON_FORK
    attributes = struct.pack("=IIQiIQQQ", 48, os.SCHED_OTHER, flags, nice, 0, SLICE, 0, 0)
    call = ctypes.CDLL(None).syscall
    return bool(call(_SYSTEM_CALL[machine], pid, attributes, 0) == 0)


def ask_for_more_turns() -> bool:
    """Have the calling thread, and those that it starts, run before starting programs do.

    As root, with CAP_SYS_NICE or within RLIMIT_NICE. Where each session has an autogroup, it is
    that of this session that must be preferred: the nice value of a thread counts only among those
    of its group (sched(7), "The autogroup feature").

    Returns:
        Whether it was permitted. A nice value that was set is kept.
    """
    if os.getpriority(os.PRIO_PROCESS, 0) != 0:
        return False
    try:
        os.setpriority(os.PRIO_PROCESS, 0, NICE)
    except OSError:
        return False
    # There are kernels without it, and containers in which /proc is read-only.
    with contextlib.suppress(OSError):
        _AUTOGROUP.write_text(str(NICE), encoding="ascii")
    return True


def run_ahead() -> bool:
    """Have the threads of this process run before all that have no real-time priority.

    Turns alone do not help where each of a hundred starting programs has its own session: each of
    their autogroups has as much right to the processors as ours. What runs ahead must leave the
    processors soon of its own accord. Needs root, CAP_SYS_NICE or RLIMIT_RTPRIO.

    Its threads and processes of later have the usual policy (SCHED_RESET_ON_FORK, sched(7)). As
    the holder of Python's global lock blocks the others, call it again for new threads.

    Returns:
        Whether it was permitted. A policy or nice value that was set is kept.
    """
    try:
        for thread in _threads():
            policy = os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK
            if policy == os.SCHED_OTHER and os.getpriority(os.PRIO_PROCESS, thread) == 0:
                os.sched_setscheduler(thread, _AHEAD, os.sched_param(_LOWEST_PRIORITY))
    except ProcessLookupError:
        pass  # a thread that has ended
    except OSError:
        return False  # sandboxes answer what they like, such as EINVAL
    return bool(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR)


def run_along() -> None:
    """Undo `run_ahead`, and ask for short turns instead."""
    with contextlib.suppress(ProcessLookupError):
        for thread in _threads():
            if os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR:
                # Without privileges, the flag cannot be removed.
                usual = os.SCHED_OTHER | os.SCHED_RESET_ON_FORK
                os.sched_setscheduler(thread, usual, os.sched_param(0))
                ask_for_short_turns(thread, children_too=False)


def _threads() -> list[int]:
    # A list of threads comes from memory: nothing here blocks.
    return [int(each) for each in os.listdir("/proc/self/task")]  # noqa: PTH208
