"""What became of the resources that a process asked for, and what to do where it did not get them.

The kernel's rules are those of sched(7), setpriority(2), ioprio_set(2), proc(5), setrlimit(2).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.core.cpu_list import cpu_text
from play_launch.core.resources import (
    IoPriority,
    ResourceLimit,
    Resources,
    Scheduler,
    limit_text,
    nice_limit,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_LIMITS_CONF: Final = "/etc/security/limits.conf"


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


def shortfalls(wanted: Resources, held: HeldResources) -> tuple[str, ...]:
    """Say what a process has not got, why, and the fix: a sentence each."""
    return tuple(_shortfalls(wanted, held))


def _shortfalls(wanted: Resources, held: HeldResources) -> Iterator[str]:
    if wanted.nice not in {None, held.nice}:
        assert wanted.nice is not None
        yield (
            f"nice is {held.nice}, not {wanted.nice}: a nice value is lowered with CAP_SYS_NICE, "
            f"or down to RLIMIT_NICE; fix: {_allow('NICE', str(wanted.nice), str(wanted.nice))}"
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
            f"fix: {_allow('MEMLOCK', 'infinity', 'unlimited')}"
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
            f"RLIMIT_RTPRIO of at least {number}; fix: {_allow('RTPRIO', number, number)}"
        )
    return (
        f"scheduler is {held}, not {wanted}: what runs under policy idle or a real-time policy "
        "leaves it with CAP_SYS_NICE; fix: AmbientCapabilities=CAP_SYS_NICE in the systemd unit "
        "of play-launch"
    )


def _rlimit(limit: ResourceLimit, soft: float, hard: float) -> str:
    unit, conf = _for_files(limit)
    why, fix = "with CAP_SYS_RESOURCE only", _allow(limit.name.upper(), unit, conf)
    if limit.name == "nofile":
        # That holds for whoever has the capability, too.
        why += ", and to fs.nr_open at most, which is never unlimited"
        if math.isfinite(limit.hard):
            fix += f"; where fs.nr_open is less, sysctl fs.nr_open={limit.hard:.0f}"
        else:
            fix = "a number of files"
    return (
        f"rlimit {limit.name} is {_pair(soft, hard)}, not {_pair(limit.soft, limit.hard)}: a hard "
        f"limit is raised {why}; fix: {fix}"
    )


def _for_files(limit: ResourceLimit) -> tuple[str, str]:
    """Write the hard limit for a unit of systemd, and for limits.conf, in the units of each."""
    text = str(limit_text(limit.hard))
    if text == "unlimited":
        return "infinity", text
    number = int(limit.hard)
    if limit.name == "nice":
        return f"{nice_limit(number):+d}", str(nice_limit(number))
    if limit.name in _IN_KIBIBYTES:
        return text, str(-(-number // 1024))
    if limit.name == "cpu":
        return f"{number}s", str(-(-number // 60))
    if limit.name == "rttime":
        return f"{number}us", text
    return text, text


_IN_KIBIBYTES: Final = frozenset({"core", "data", "fsize", "memlock", "rss", "stack", "as"})


def _pair(soft: float, hard: float) -> str:
    return f"{limit_text(soft)}" if soft == hard else f"{limit_text(soft)}:{limit_text(hard)}"


def _allow(limit: str, unit: str, conf: str) -> str:
    return (
        f"Limit{limit}={unit} in the systemd unit of play-launch, or the line "
        f'"<user> - {_CONF_NAMES.get(limit, limit.lower())} {conf}" in {_LIMITS_CONF}'
    )


_CONF_NAMES: Final = {"RTPRIO": "rtprio", "NICE": "nice"}
