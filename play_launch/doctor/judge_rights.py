"""Judges what the kernel and whoever started us allow. Pure: facts in, findings out.

None of it is needed unless a configuration asks for it, so nothing here is a warning.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.config.resources import nice_limit
from play_launch.doctor.facts import KeySupport
from play_launch.doctor.finding import Finding, ok, size_text
from play_launch.doctor.rights import Right, how_to_get
from play_launch.process.cgroups.controllers import VERSION_2_FIX, Lack, switched_on

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from play_launch.doctor.facts import GroupFacts, LimitFacts, MachineFacts
    from play_launch.doctor.surroundings import Surroundings

_HIGHEST_PRIORITY: Final = 99
_CONTROLLERS: Final = ("cpu", "cpuset", "io", "memory", "pids")
_KEYS: Final[Mapping[KeySupport, str]] = {
    KeySupport.NO_CPU: "the CPU has none (no pku in /proc/cpuinfo)",
    KeySupport.NO_KERNEL: "the CPU has them (pku in /proc/cpuinfo), the kernel does not (no ospke)",
    KeySupport.REFUSED: "CPU and kernel have them, and pkey_alloc() is refused",
    KeySupport.USABLE: "CPU and kernel have them, for the private memory of isolated nodes",
}
_KEYS_FIX: Final[Mapping[KeySupport, str]] = {
    KeySupport.NO_KERNEL: "boot without nopku, with a kernel that has "
    "CONFIG_X86_INTEL_MEMORY_PROTECTION_KEYS; of a virtual machine, let its CPU have pku",
    KeySupport.REFUSED: "allow pkey_alloc, pkey_free and pkey_mprotect in the seccomp profile",
}


def judge_rights(facts: MachineFacts) -> list[Finding]:
    """Judge control groups, protection keys, scheduling and locked memory."""
    started_by, limits = facts.surroundings, facts.limits
    return [
        _control_groups(facts.groups, started_by),
        ok("protection keys", _keys(facts.keys), _KEYS_FIX.get(facts.keys, "")),
        _real_time(limits, started_by),
        _nice_values(limits, started_by),
        _locked_memory(limits, started_by),
    ]


def _keys(support: KeySupport) -> str:
    consequence = "private memory of isolated nodes is ordinary memory, see memory_domains"
    usable = support is KeySupport.USABLE
    return _KEYS[support] if usable else f"{_KEYS[support]}; {consequence}"


def _control_groups(facts: GroupFacts, started_by: Surroundings) -> Finding:
    subject = "control groups"
    if facts.problem:
        says, _, fix = facts.problem.partition("; fix: ")
        if facts.folder:
            fix = how_to_get(Right.CONTROL_GROUPS, started_by, from_login=fix)
        return ok(subject, f"{says}: no limits for groups", fix)
    where = f"version 2, {facts.folder}, ours"
    has = [each for each in _CONTROLLERS if each in facts.controllers]
    missing = [each for each in _CONTROLLERS if each not in facts.controllers]
    if not missing:
        return ok(subject, f"{where}, with {', '.join(has)}")
    if has:
        says = f"{where}, with {', '.join(has)}; without {', '.join(missing)}"
    else:
        says = f"{where}, without controllers: no limits for groups"
    return ok(subject, says, "\n".join(_fixes(missing, facts.lacks, started_by)))


def _fixes(
    missing: list[str], lacks: Mapping[str, Lack], started_by: Surroundings
) -> Iterator[str]:
    """Give what brings controllers here, a line for each cause."""
    found = [lacks.get(each, Lack.NOT_GIVEN) for each in missing]
    if Lack.IN_VERSION_1 in found:
        yield VERSION_2_FIX
    for controller, lack in zip(missing, found, strict=True):
        if lack is Lack.SWITCHED_OFF:
            yield switched_on(controller)
    if Lack.NOT_GIVEN in found:
        yield how_to_get(Right.CONTROLLERS, started_by)


def _real_time(facts: LimitFacts, started_by: Surroundings) -> Finding:
    subject = "real-time"
    if facts.real_time_share == 0:
        says = "switched off for all: scheduler policies fifo and rr are refused"
        return ok(subject, says, "sysctl kernel.sched_rt_runtime_us=950000")
    share = facts.real_time_share
    of_time = "" if share is None else f", {100 * share:.0f} % of the time"
    if facts.may_schedule:
        return ok(subject, f"priorities up to {_HIGHEST_PRIORITY} (CAP_SYS_NICE){of_time}")
    highest = facts.rtprio.soft
    if highest == 0:
        says = "no priorities: scheduler policies fifo and rr are refused"
        return ok(subject, says, how_to_get(Right.REAL_TIME, started_by))
    highest = _HIGHEST_PRIORITY if highest is None else highest
    return ok(subject, f"priorities up to {highest}{of_time}")


def _nice_values(facts: LimitFacts, started_by: Surroundings) -> Finding:
    subject = "nice values"
    limit = facts.nice.soft
    lowest = -20 if facts.may_schedule or limit is None else nice_limit(limit)
    if lowest > 0:
        return ok(subject, "none below that of play-launch", how_to_get(Right.NICE, started_by))
    return ok(subject, f"down to {lowest}")


def _locked_memory(facts: LimitFacts, started_by: Surroundings) -> Finding:
    subject = "locked memory"
    if facts.may_lock_memory:
        return ok(subject, "unlimited (CAP_IPC_LOCK)")
    if facts.memlock.soft is None:
        return ok(subject, "unlimited")
    says = f"{size_text(facts.memlock.soft)}; lock_memory and mlockall() need more"
    return ok(subject, says, how_to_get(Right.LOCKED_MEMORY, started_by))
