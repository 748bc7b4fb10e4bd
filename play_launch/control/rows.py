"""What ``ps`` shows: one row for each container, composable node and ordinary process."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Any, Final

from play_launch.process.cgroups.usage import group_of, usage_of
from play_launch.process.exit import UNKNOWN_STATUS
from play_launch.supervisor.events import (
    MemoryKind,
    NodeState,
    ProcessEventKind,
    ProcessSample,
    SubjectKind,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from play_launch.supervisor.view import ContainerView, NodeView, ProcessView, SystemView

CONTAINER: Final = "container"
COMPONENT: Final = "component"
PROCESS: Final = "process"

_STATE_OF_PROCESS: Final = {
    ProcessEventKind.STARTED: "running",
    ProcessEventKind.READY: "running",
    ProcessEventKind.EXITED: "exited",
    ProcessEventKind.RESTARTING: "backoff",
    ProcessEventKind.GAVE_UP: "gave up",
    ProcessEventKind.STOPPING: "stopping",
    ProcessEventKind.WAITING: "waiting",
    ProcessEventKind.STOPPED: "stopped",
}
_TICKS: Final = os.sysconf("SC_CLK_TCK")
_MOST_AGE_NS: Final = 30_000_000_000
"""A sample that is older than this says nothing about now."""

Samples = dict[tuple[SubjectKind, str], ProcessSample]
"""The latest one of each subject."""


class Clock:
    """A moment, on the clocks that facts about processes are in."""

    def __init__(self, now_ns: int | None = None, boot_s: float | None = None) -> None:
        """Take nanoseconds since the epoch and seconds since the boot; None: now."""
        self.now_ns = time.time_ns() if now_ns is None else now_ns
        self.boot_s = time.clock_gettime(time.CLOCK_BOOTTIME) if boot_s is None else boot_s

    def age(self, start_time: int) -> float | None:
        """Seconds since a number of clock ticks after the boot; None for 0."""
        return max(self.boot_s - start_time / _TICKS, 0.0) if start_time else None

    def since(self, stamp_ns: int) -> float:
        """Seconds since a wall-clock time."""
        return max((self.now_ns - stamp_ns) / 1e9, 0.0)


def rows_of(
    view: SystemView, processes: Iterable[str], samples: Samples, clock: Clock
) -> list[dict[str, Any]]:
    """Make the rows: each container before its nodes, as declared; then the processes.

    Args:
        view: The system as it stands.
        processes: Names of all ordinary processes that are declared.
        samples: What processes use.
        clock: Now.
    """
    rows: list[dict[str, Any]] = []
    for container in view.containers.values():
        rows += _of_container(container, view, samples, clock)
    # Those that were never started yet are in no event.
    names = dict.fromkeys([*processes, *view.processes])
    rows += [_of_process(name, view, samples, clock) for name in names]
    return rows


def add_groups(rows: Iterable[dict[str, Any]]) -> None:
    """Add to each row what the control group of its process uses; reads files of the kernel."""
    pids: dict[str, int] = {}
    for row in rows:
        pid = row["pid"]
        if row["kind"] == CONTAINER:
            pids[row["name"]] = pid
        is_own = pid is not None and pid != pids.get(row["container"])
        group = group_of(pid) if is_own else None
        row["cgroup"] = None if group is None else usage_of(group).described()


def _of_container(
    container: ContainerView, view: SystemView, samples: Samples, clock: Clock
) -> Iterator[dict[str, Any]]:
    process = container.process
    yield {
        "name": container.name,
        "kind": CONTAINER,
        "container": None,
        "state": container.state.value,
        "reason": container.reason,
        "managed": None,
        **_of_life(process, clock),
        "crashes": container.crashes,
        **_usage(samples.get((SubjectKind.CONTAINER, container.name)), process.pid, clock),
    }
    for node in container.nodes.values():
        yield _of_node(node, container, view, samples, clock)


def _of_node(
    node: NodeView, container: ContainerView, view: SystemView, samples: Samples, clock: Clock
) -> dict[str, Any]:
    is_loaded = node.state is NodeState.LOADED
    is_there = is_loaded or node.state in {NodeState.LOADING, NodeState.UNLOADING}
    pid = node.pid if is_there and container.process.pid else 0
    has_process = pid not in {0, container.process.pid}
    return {
        "name": node.node,
        "kind": COMPONENT,
        "container": node.container,
        "state": node.state.value,
        "reason": node.reason,
        "managed": _managed(view, str(node.key)),
        "pid": pid or None,
        "restarts": node.reloads,
        "uptime_s": round(clock.since(node.since_ns), 3) if is_loaded else None,
        "exit_code": None,
        "signal": None,
        "crashes": node.crashes,
        # Without a process of its own, what it uses is in the numbers of its container.
        **_usage(
            samples.get((SubjectKind.NODE, str(node.key))) if has_process else None, pid, clock
        ),
    }


def _of_process(name: str, view: SystemView, samples: Samples, clock: Clock) -> dict[str, Any]:
    process = view.processes.get(name)
    row: dict[str, Any] = {"name": name, "kind": PROCESS, "container": None}
    if process is None:
        return {
            **row,
            "state": "pending",
            "reason": "",
            "managed": None,
            "pid": None,
            "restarts": 0,
            "uptime_s": None,
            "exit_code": None,
            "signal": None,
            "crashes": 0,
            **_usage(None, 0, clock),
        }
    return {
        **row,
        "state": _STATE_OF_PROCESS[process.kind],
        "reason": process.message,
        "managed": _managed(view, name),
        **_of_life(process, clock),
        "crashes": 0,
        **_usage(samples.get((SubjectKind.PROCESS, name)), process.pid, clock),
    }


def _managed(view: SystemView, unit: str) -> dict[str, str] | None:
    found = view.managed.get(unit)
    return None if found is None else {"state": found.state.value, "reason": found.reason}


def _of_life(process: ProcessView, clock: Clock) -> dict[str, Any]:
    age = clock.age(process.start_time) if process.pid else None
    has_ended = process.kind in {
        ProcessEventKind.EXITED,
        ProcessEventKind.RESTARTING,
        ProcessEventKind.GAVE_UP,
    }
    is_known = process.exit_code != UNKNOWN_STATUS
    return {
        "pid": process.pid or None,
        "restarts": process.restarts,
        "uptime_s": None if age is None else round(age, 3),
        "exit_code": process.exit_code if has_ended and is_known else None,
        "signal": process.signal or None if has_ended else None,
    }


def _usage(sample: ProcessSample | None, pid: int, clock: Clock) -> dict[str, Any]:
    if sample is None or sample.pid != pid or clock.now_ns - sample.stamp_ns > _MOST_AGE_NS:
        return {"cpu_percent": None, "memory_bytes": None, "memory_kind": None}
    # Memory that is shared with the container is no node's own.
    is_shared = sample.memory_kind is MemoryKind.SHARED
    return {
        "cpu_percent": round(sample.cpu_percent, 2),
        "memory_bytes": None if is_shared else sample.memory_bytes,
        "memory_kind": sample.memory_kind.name.lower(),
    }
