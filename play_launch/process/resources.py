"""Which resources a process has, as the kernel says, and what to do where it lacks some.

The kernel's rules are those of sched(7), setpriority(2), ioprio_set(2), proc(5), setrlimit(2).
"""

from __future__ import annotations

import ctypes
import math
import os
import resource
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.config.resources import (
    POLICY_NUMBERS,
    IoPriority,
    ResourceLimit,
    Resources,
    Scheduler,
    SchedulerPolicy,
    cpu_text,
    limit_text,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_POLICIES: Final = {number: policy for policy, number in POLICY_NUMBERS.items()}
_NICE, _PRIORITY, _POLICY = 19, 40, 41
"""Fields of proc_pid_stat(5)."""
_BEFORE_NAME: Final = 3
"""The number of the field behind the name, which is the first that can be split off."""
_IOPRIO_GET: Final = {"x86_64": 252, "aarch64": 31, "riscv64": 31}
_OF_PROCESS: Final = 1


class HeldResources(Struct, frozen=True, kw_only=True):
    """What a process has."""

    nice: int
    scheduler: Scheduler
    cpu_affinity: tuple[int, ...]
    io_priority: IoPriority | None
    """None where that is not known."""
    oom_score_adj: int
    locks_memory: bool
    rlimits: Mapping[str, tuple[float, float]]


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


def shortfalls(wanted: Resources, held: HeldResources) -> tuple[str, ...]:
    """Describe the resources that a process lacks, with cause and fix: a sentence each."""
    return tuple(_shortfalls(wanted, held))


def _shortfalls(wanted: Resources, held: HeldResources) -> Iterator[str]:
    if wanted.nice not in {None, held.nice}:
        assert wanted.nice is not None
        yield (
            f"nice is {held.nice}, not {wanted.nice}: a nice value is lowered with CAP_SYS_NICE, "
            f"or down to RLIMIT_NICE; fix: {_allow('NICE', str(wanted.nice))}"
        )
    if wanted.scheduler not in {None, held.scheduler}:
        yield _scheduler(wanted.scheduler, held.scheduler)
    if wanted.cpu_affinity not in {(), held.cpu_affinity}:
        yield (
            f"cpu_affinity is {cpu_text(held.cpu_affinity)}, not {cpu_text(wanted.cpu_affinity)}: "
            "this machine, or the cpuset that play-launch runs in, has no other CPUs; fix: name "
            "those of /proc/self/status, Cpus_allowed_list"
        )
    if wanted.io_priority is not None and held.io_priority not in {None, wanted.io_priority}:
        yield (
            f"io_priority is {held.io_priority}, not {wanted.io_priority}: the class realtime "
            "takes CAP_SYS_NICE; fix: AmbientCapabilities=CAP_SYS_NICE in the systemd unit of "
            "play-launch, or the class best_effort"
        )
    if wanted.oom_score_adj not in {None, held.oom_score_adj}:
        yield (
            f"oom_score_adj is {held.oom_score_adj}, not {wanted.oom_score_adj}: it is lowered "
            "with CAP_SYS_RESOURCE only; fix: OOMScoreAdjust="
            f"{wanted.oom_score_adj} in the systemd unit of play-launch"
        )
    if wanted.lock_memory and not held.locks_memory:
        yield (
            "its memory is not locked: that takes CAP_IPC_LOCK or an unlimited RLIMIT_MEMLOCK; "
            f"fix: {_allow('MEMLOCK', 'infinity')}"
        )
    for limit in wanted.rlimits:
        soft, hard = held.rlimits[limit.name]
        if (soft, hard) != (limit.soft, limit.hard):
            yield _rlimit(limit, soft, hard)


def _scheduler(wanted: Scheduler | None, held: Scheduler) -> str:
    assert wanted is not None
    if wanted.policy.is_real_time:
        number = str(wanted.priority)
        return (
            f"scheduler is {held}, not {wanted}: real-time priorities take CAP_SYS_NICE, or "
            f"RLIMIT_RTPRIO of at least {number}; fix: {_allow('RTPRIO', number)}"
        )
    return (
        f"scheduler is {held}, not {wanted}: what runs under policy idle or a real-time policy "
        "leaves it with CAP_SYS_NICE; fix: AmbientCapabilities=CAP_SYS_NICE in the systemd unit "
        "of play-launch"
    )


def _rlimit(limit: ResourceLimit, soft: float, hard: float) -> str:
    why = "with CAP_SYS_RESOURCE only"
    if limit.name == "nofile":
        why += ", and to fs.nr_open (sysctl) at most"
    value = "infinity" if math.isinf(limit.hard) else f"{limit.hard:.0f}"
    return (
        f"rlimit {limit.name} is {_pair(soft, hard)}, not {_pair(limit.soft, limit.hard)}: a hard "
        f"limit is raised {why}; fix: {_allow(limit.name.upper(), value)}"
    )


def _pair(soft: float, hard: float) -> str:
    return f"{limit_text(soft)}" if soft == hard else f"{limit_text(soft)}:{limit_text(hard)}"


def _allow(limit: str, value: str) -> str:
    return f"Limit{limit}={value} in the systemd unit of play-launch, see docs/resources.md#rights"
