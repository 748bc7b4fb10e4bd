"""Which resources a process has, as the kernel says."""

from __future__ import annotations

import ctypes
import math
import os
import resource
from pathlib import Path
from typing import Final

from play_launch.core.resource_check import HeldResources
from play_launch.core.resources import (
    POLICY_NUMBERS,
    IoPriority,
    Scheduler,
    SchedulerPolicy,
)

_POLICIES: Final = {number: policy for policy, number in POLICY_NUMBERS.items()}
_NICE, _PRIORITY, _POLICY = 19, 40, 41
"""Fields of proc_pid_stat(5)."""
_BEFORE_NAME: Final = 3
"""The number of the field behind the name, which is the first that can be split off."""
_IOPRIO_GET: Final = {"x86_64": 252, "aarch64": 31, "riscv64": 31}
_OF_PROCESS: Final = 1


def held_resources(pid: int, limits: tuple[str, ...] = ()) -> HeldResources | None:
    """Read what a process has of all that can be asked for; None when it has ended.

    Args:
        pid: Its pid; of a process that may have ended, one that was not waited for.
        limits: The names of the limits to read.
    """
    folder = Path("/proc", str(pid))
    try:
        text = (folder / "stat").read_text(encoding="utf-8", errors="replace")
        fields = text.rpartition(")")[2].split()
        nice, priority, number = (
            int(fields[field - _BEFORE_NAME]) for field in (_NICE, _PRIORITY, _POLICY)
        )
        policy = _POLICIES.get(number, SchedulerPolicy.OTHER)
        status = (folder / "status").read_text(encoding="utf-8", errors="replace")
        return HeldResources(
            nice=nice,
            scheduler=Scheduler(policy, priority if policy.is_real_time else 0),
            cpu_affinity=tuple(sorted(os.sched_getaffinity(pid))),
            io_priority=_io_priority(pid),
            oom_score_adj=int((folder / "oom_score_adj").read_text()),
            locks_memory=_locked_kibibytes(status) > 0,
            rlimits={name: _limit(pid, name) for name in limits},
        )
    except (OSError, IndexError):
        return None


def _locked_kibibytes(status: str) -> int:
    for line in status.splitlines():
        if line.startswith("VmLck:"):
            return int(line.split()[1])
    return 0


def _limit(pid: int, name: str) -> tuple[float, float]:
    soft, hard = resource.prlimit(pid, getattr(resource, f"RLIMIT_{name.upper()}"))
    return _plain(soft), _plain(hard)


def _plain(limit: int) -> float:
    return math.inf if limit == resource.RLIM_INFINITY else limit


def _io_priority(pid: int) -> IoPriority | None:
    """Ask the kernel, which shows it nowhere in /proc."""
    number = _IOPRIO_GET.get(os.uname().machine)
    if number is None:
        return None
    value: int = ctypes.CDLL(None, use_errno=True).syscall(number, _OF_PROCESS, pid)
    return IoPriority.of_number(value) if value >= 0 else None
