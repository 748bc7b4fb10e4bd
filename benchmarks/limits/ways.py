"""The ways to keep a control node and a greedy one apart, and which of them this machine has."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from play_launch.process.cgroups.group import GroupError
from play_launch.process.cgroups.session_groups import delegated_group

_HIGHEST_NICE: Final = 19


@dataclass(frozen=True, slots=True)
class Way:
    """`resources` of both nodes; with an `obstacle` it cannot be measured here."""

    name: str
    control: Mapping[str, Any] = field(default_factory=dict)
    greedy: Mapping[str, Any] = field(default_factory=dict)
    is_alone: bool = False
    obstacle: str = ""


def ways() -> list[Way]:
    """All of them, in the order of the table."""
    fifo = {"scheduler": {"policy": "fifo", "priority": 80}}
    first, *others = sorted(os.sched_getaffinity(0))
    own, rest = {"cpu_affinity": [first]}, {"cpu_affinity": others}
    no_real_time = "" if _may_be_real_time() else "the kernel refuses real-time priorities"
    one_cpu = "" if others else "there is one CPU only"
    groups = groups_problem()
    return [
        Way("alone", is_alone=True),
        Way("alone, fifo 80", fifo, is_alone=True, obstacle=no_real_time),
        Way("beside the greedy node"),
        Way(f"greedy: nice {_HIGHEST_NICE}", greedy={"nice": _HIGHEST_NICE}),
        Way("greedy: policy idle", greedy={"scheduler": {"policy": "idle"}}),
        Way("CPUs of their own", own, rest, obstacle=one_cpu),
        Way("control: fifo 80", fifo, obstacle=no_real_time),
        Way("fifo 80, CPUs of their own", fifo | own, rest, obstacle=no_real_time or one_cpu),
        Way("cpu_weight 1000 to 10", {"cpu_weight": 1000}, {"cpu_weight": 10}, obstacle=groups),
        Way("greedy: cpu_max 20 %", greedy={"cpu_max": "20 %"}, obstacle=groups),
        Way(
            "cpusets of their own",
            {"cpuset": [first]},
            {"cpuset": others},
            obstacle=groups or one_cpu,
        ),
    ]


def _may_be_real_time() -> bool:
    """Whether processes that we start may ask for it: one is asked."""
    if (pid := os.fork()) == 0:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(81))
        except OSError:
            os._exit(1)
        os._exit(0)
    return os.waitpid(pid, 0)[1] == 0


def groups_problem() -> str:
    """Give the reason why there are no control groups with limits; empty if there are."""
    try:
        group = delegated_group()
    except GroupError as error:
        return str(error).partition(";")[0]
    missing = sorted({"cpu", "cpuset"} - set((group / "cgroup.controllers").read_text().split()))
    return f"there are no controllers {', '.join(missing)}" if missing else ""
