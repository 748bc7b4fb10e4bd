"""`resources` of a container, a composable node or a process."""

from __future__ import annotations

from enum import Enum, auto
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from play_launch.config.group_limits import LIMIT_KEYS, NO_LIMIT, cpu_text
from play_launch.config.model import Isolation
from play_launch.config.resources import Resources, Scheduler

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.config.group_limits import GroupLimits
    from play_launch.config.resource_schema import (
        LimitsSection,
        ResourcesSection,
        SchedulerSection,
    )
    from play_launch.config.yaml.tree import At

KEY: Final = "resources"
_RLIMITS: Final = "rlimits"
_SHARED_LIMIT: Final = "the limit is about memory or descriptors that it shares with its container"
_EXEC: Final = (
    "a lock on memory does not survive the start of a program; have the program call mlockall(), "
    "which rlimits: {memlock: unlimited} allows"
)
_SHARED_MEMORY: Final = (
    "the kernel accounts the memory of a node that shares it to its container; give it to the "
    "container, or use isolation: process"
)
_CORE_DUMPS: Final = "the key core_dumps of the container says that"


class Process(Enum):
    """What kind of process asks."""

    CONTAINER = auto()
    """Of play-launch's own."""
    PROGRAM = auto()
    """A program other than play-launch's container."""
    NODE_WITH_OWN_MEMORY = auto()
    NODE_IN_SHARED_MEMORY = auto()


_IMPOSSIBLE: Final[Mapping[Process, Mapping[str, str]]] = {
    Process.CONTAINER: {},
    Process.PROGRAM: {"lock_memory": _EXEC},
    Process.NODE_WITH_OWN_MEMORY: {"rlimits.core": _CORE_DUMPS},
    Process.NODE_IN_SHARED_MEMORY: {
        "lock_memory": "it shares the memory of its container; give it to the container",
        "oom_score_adj": "the kernel has one for all processes that share memory; give it to the "
        "container",
        "memory_high": _SHARED_MEMORY,
        "memory_max": _SHARED_MEMORY,
        "rlimits.core": _CORE_DUMPS,
        **{
            f"{_RLIMITS}.{name}": f"{_SHARED_LIMIT}; give it to the container"
            for name in ("as", "data", "memlock", "nofile", "stack")
        },
    },
}
"""What such a process cannot have, with the reason."""


def node_process(isolation: Isolation) -> Process:
    """What an isolated node is; where that is up to the machine, it may share memory."""
    own = isolation is Isolation.PROCESS
    return Process.NODE_WITH_OWN_MEMORY if own else Process.NODE_IN_SHARED_MEMORY


def refined_resources(
    base: Resources, section: ResourcesSection | None, at: At, process: Process
) -> Resources:
    """Return `base` with what `section` says instead, which is the key `resources` at `at`."""
    if section is not None:
        where = at.blame(KEY)
        if refuse(where, process):
            return base
        base = replace(base, **_given(base, section, where))
        _refuse_contradictions(base, where)
    return base


def _refuse_contradictions(resources: Resources, at: At) -> None:
    """Report what the kernel takes, or refuses, without anything of it ever holding."""
    group, cpus = resources.group, set(resources.cpu_affinity)
    if cpus and group.cpuset and not cpus.intersection(group.cpuset):
        at.blame("cpu_affinity").problem(
            f"none of these CPUs is in its cpuset, {cpu_text(group.cpuset)}; give one of the two"
        )
    high, most = group.memory_high, group.memory_max
    if high is not None and most is not None and most < high < NO_LIMIT:
        at.blame("memory_high").problem("is never reached: it is above memory_max")


def refuse_inherited(resources: Resources, at: At, process: Process) -> None:
    """Report what the defaults give a process that cannot have it; it stands at `at`."""
    limits = {f"{_RLIMITS}.{limit.name}" for limit in resources.rlimits}
    inherited = (resources.described().keys() | limits) - _keys(at.value(KEY))
    for name, why in _IMPOSSIBLE[process].items():
        if name in inherited:
            at.problem(f"{name} of composable_node_loading cannot hold for it: {why}")


def refuse(at: At, process: Process) -> bool:
    """Report what stands there that such a process cannot have; whether there was any."""
    limits = at.value(_RLIMITS)
    refused = False
    for name, why in _IMPOSSIBLE[process].items():
        key, _, limit = name.partition(".")
        value = at.value(key) if not limit else limits and limits.value(limit)
        if value is not None:
            value.problem(f"{limit or key} cannot be given here: {why}")
            refused = True
    return refused


def _keys(at: At | None) -> set[str]:
    """Name what stands there."""
    if at is None:
        return set()
    limits = at.value(_RLIMITS)
    names = {entry.key for entry, _ in at.entries()}
    if limits is not None:
        names |= {f"{_RLIMITS}.{entry.key}" for entry, _ in limits.entries()}
    return names


def _given(base: Resources, section: ResourcesSection, at: At) -> dict[str, Any]:
    given = {key: value for key, value in section.given.items() if key not in LIMIT_KEYS}
    given["group"] = refined_limits(base.group, section)
    if section.scheduler is not None:
        given["scheduler"] = scheduler = _scheduler(section.scheduler, at)
        if scheduler.policy.is_real_time and section.nice is not None:
            at.blame("nice").problem(f"nothing reads it with the policy {scheduler.policy}")
    if section.rlimits is not None:
        limits = {limit.name: limit for limit in (*base.rlimits, *section.rlimits.given.values())}
        given[_RLIMITS] = tuple(limits[name] for name in sorted(limits))
    return given


def refined_limits(base: GroupLimits, section: LimitsSection) -> GroupLimits:
    """Return `base` with what `section` says instead."""
    given = section.given
    if "cpuset_cpus" in given:
        given["cpuset"] = given["cpuset_cpus"]
    limits = {key: value for key, value in given.items() if key in LIMIT_KEYS}
    return replace(base, **limits) if limits else base


def _scheduler(section: SchedulerSection, at: At) -> Scheduler:
    where = at.blame("scheduler")
    if section.policy.is_real_time and section.priority is None:
        where.problem(f'the key "priority", 1 to 99, is missing, which goes with {section.policy}')
    elif section.priority is not None and not section.policy.is_real_time:
        where.blame("priority").problem(f"only for fifo and rr, the policy is {section.policy}")
    return Scheduler(section.policy, section.priority or 0)
