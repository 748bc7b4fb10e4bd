"""The keys of `resources` and of control groups, see `play_launch.config.schema`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from play_launch.config import kinds
from play_launch.config.resource_values import LIMIT_FORMS
from play_launch.config.resources import SchedulerPolicy
from play_launch.config.section import Section, nested, optional, raw, required

if TYPE_CHECKING:
    from play_launch.config.resources import CpuMax, IoPriority


class SchedulerSection(Section):
    """`resources.scheduler`: the policy of the kernel's scheduler."""

    policy: SchedulerPolicy = required(
        kinds.choice(SchedulerPolicy),
        "Policy: other, batch, idle, fifo or rr; see sched(7).",
        "fifo",
    )
    priority: int | None = optional(
        kinds.integer(1, 99), "Priority from 1 to 99 (first); for fifo and rr.", 50
    )


RlimitsSection: type[Section] = type(
    "RlimitsSection",
    (Section,),
    # One of them is a keyword of Python.
    {
        "__doc__": "`resources.rlimits`: limits of setrlimit(2), by their names.",
        **{
            name: optional(kinds.resource_limit(name), form.meaning, form.example)
            for name, form in LIMIT_FORMS.items()
        },
    },
)


class LimitsSection(Section):
    """Limits of a control group, wherever they stand."""

    cpu_max: CpuMax | None = optional(
        kinds.CPU_MAX,
        "CPU time of its control group: a share of one CPU, a quota and a period in "
        "microseconds, or max.",
        "50 %",
        "200 %",
        "5000 10000",
    )
    cpu_weight: int | None = optional(
        kinds.WEIGHT,
        "Share of the CPU time where several control groups want it, 1 to 10000; others have 100.",
        200,
    )
    cpuset: tuple[int, ...] | None = optional(
        kinds.CPUS, "CPUs of its control group.", "0-3", [2, 3]
    )
    io_weight: int | None = optional(
        kinds.WEIGHT,
        "Share of the disk accesses where several control groups want them, 1 to 10000.",
        50,
    )
    pids_max: float | None = optional(
        kinds.PIDS_MAX, "Processes and threads in its control group, or max.", 64
    )
    memory_high: float | None = optional(
        kinds.MEMORY_LIMIT,
        "Memory from which on its control group is slowed down; not for a node that shares memory.",
        "400 MB",
    )
    memory_max: float | None = optional(
        kinds.MEMORY_LIMIT,
        "Memory at which its control group is killed; not for a node that shares memory.",
        "512 MB",
        "max",
    )


class GroupLimitsSection(LimitsSection):
    """`defaults` and entries of `per_node` of `cgroups`."""

    cpuset_cpus: tuple[int, ...] | None = optional(kinds.CPUS, "Another name of cpuset.", "0-3")


class ResourcesSection(LimitsSection):
    """`resources`: what a process asks of the kernel for itself."""

    nice: int | None = optional(kinds.integer(-20, 19), "Nice value, -20 (first) to 19.", 5, -5)
    scheduler: SchedulerSection | None = nested(
        SchedulerSection,
        "Policy of the scheduler, with the priority of a real-time one.",
        {"policy": "fifo", "priority": 50},
        {"policy": "batch"},
    )
    cpu_affinity: tuple[int, ...] | None = optional(
        kinds.CPUS, "CPUs that it may run on.", [2, 3], "0-3,6", 2
    )
    io_priority: IoPriority | None = optional(
        kinds.IO_PRIORITY,
        "Priority of its disk accesses: idle, best_effort or realtime, with a level from 0 "
        "(first) to 7.",
        "best_effort:2",
        "idle",
    )
    oom_score_adj: int | None = optional(
        kinds.integer(-1000, 1000),
        "Preference of the kernel's OOM killer: -1000 (never) to 1000.",
        500,
    )
    lock_memory: bool | None = optional(
        kinds.BOOLEAN,
        "Whether its memory stays in RAM; for containers and isolation: process.",
        True,
    )
    rlimits: Section | None = nested(
        RlimitsSection,
        "Limits of setrlimit(2): one value, or soft:hard.",
        {"nofile": 65536, "core": "unlimited"},
        {"nofile": "1024:65536"},
    )


class CgroupsSection(Section):
    """`composable_node_loading.cgroups`: whether there are control groups, and where."""

    enabled: bool | None = optional(
        kinds.BOOLEAN,
        "Whether processes have control groups. By default where limits are asked for.",
        True,
    )
    required: bool | None = optional(
        kinds.BOOLEAN,
        "Whether nothing starts without its control group and its limits. By default false.",
        True,
    )
    base_path: str | None = optional(
        kinds.GROUP_PATH,
        "Control group below which those of the session are made. By default auto: the one that "
        "play-launch runs in, where that is delegated.",
        "auto",
        "/sys/fs/cgroup/play_launch",
    )
    defaults: GroupLimitsSection | None = nested(
        GroupLimitsSection, "Limits of isolated nodes.", {"cpu_weight": 100}
    )
    per_node: Any = raw(
        "Limits by the name, or full name, of isolated nodes.",
        {"pointcloud_filter": {"cpu_max": "50000 100000", "cpuset_cpus": "0-3"}},
    )
