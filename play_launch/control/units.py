"""Containers, processes and composable nodes: chosen by name, and described for clients."""

from __future__ import annotations

import itertools
import os
import time
from enum import StrEnum
from fnmatch import fnmatchcase
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from play_launch.config.node_key import NodeKey
from play_launch.config.text import listed, similar
from play_launch.container.messages import state_of_guest
from play_launch.control.messages import Managed, UnitRow, UnitStatus
from play_launch.control.protocol import MEMBER_ACTIONS, NODE_ACTIONS, Code, OperationError
from play_launch.process.cgroups.usage import group_of, usage_of
from play_launch.process.exit import UNKNOWN_STATUS
from play_launch.supervisor.events import (
    MemoryKind,
    NodeState,
    ProcessEventKind,
    ProcessSample,
    SubjectKind,
)
from play_launch.supervisor.world import Process, is_wanted

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from play_launch.control.messages import LastLine, RestartRecord
    from play_launch.supervisor.events import NodeStateChanged, ProcessEvent
    from play_launch.supervisor.view import ContainerView, SystemView
    from play_launch.supervisor.world import Node, World

Target = NodeKey | str
"""A composable node, or the full name of a container or ordinary process."""
Samples = dict[tuple[SubjectKind, str], ProcessSample]
"""The latest sample of each subject."""

OF_ANOTHER_PROGRAM: Final = "was loaded by another program, and is only listed"
_LISTED: Final = 10
"""Names in an error."""
_WILD: Final = frozenset("*?[")
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
_ENDED: Final = frozenset(
    {ProcessEventKind.EXITED, ProcessEventKind.RESTARTING, ProcessEventKind.GAVE_UP}
)
_HAS_PROCESS: Final = frozenset({NodeState.LOADED, NodeState.LOADING, NodeState.UNLOADING})
_TICKS: Final = os.sysconf("SC_CLK_TCK")
_SAMPLE_AGE_LIMIT_NS: Final = 30_000_000_000
"""Older samples are not shown."""


class Health(StrEnum):
    """Class of a state, worst first."""

    FAILED = "failed"
    CHANGING = "changing"
    UP = "up"
    INACTIVE = "inactive"


_HEALTH: Final = {
    "running": Health.UP,
    "loaded": Health.UP,
    **dict.fromkeys(("stopped", "unloaded", "exited"), Health.INACTIVE),
    **dict.fromkeys(
        ("gave up", "load failed", "crashed", "lost", "backoff", "killing"), Health.FAILED
    ),
}


def health(row: UnitRow) -> Health:
    """Classify a row; an unknown state counts as changing."""
    if row.state == "exited" and (row.exit_code or row.signal):
        return Health.FAILED
    return _HEALTH.get(row.state, Health.CHANGING)


def health_counts(rows: Sequence[UnitRow]) -> str:
    """Summarise the system: ``7 of 9 up, 1 failed, 1 inactive``."""
    states = [health(row) for row in rows]
    others = [
        f"{states.count(each)} {each}"
        for each in Health
        if each in states and each is not Health.UP
    ]
    return ", ".join([f"{states.count(Health.UP)} of {len(rows)} up", *others])


def members_of(view: SystemView, processes: Iterable[str]) -> list[Target]:
    return list(dict.fromkeys([*view.containers, *processes, *view.processes]))


def nodes_of(view: SystemView) -> list[Target]:
    return [key for container in view.containers.values() for key in container.nodes]


def guests_of(view: SystemView) -> dict[Target, str]:
    """Give the nodes that other programs have loaded, each with why nothing is done to it."""
    every = [(each.name, name) for each in view.containers.values() for name in each.guests]
    return dict.fromkeys(itertools.starmap(NodeKey, every), OF_ANOTHER_PROGRAM)


def full_name(target: Target) -> str:
    """Name in the graph; the label of a node without a name."""
    return target if isinstance(target, str) else target.name


def chosen(
    wanted: Sequence[str],
    candidates: Sequence[Target],
    others: Mapping[Target, str] = MappingProxyType({}),
) -> list[Target]:
    """Find the units that names and patterns mean, in the order of the candidates, each once.

    They are full names, names without their namespace where only one has it, or patterns (``*``,
    ``?`` and ``[]`` as in a shell, over the full name); a composable node can also be written with
    its container, ``/container:/node``. ``others`` are units that the operation is not for, and
    why. Raises OperationError where one means nothing, or a name several.
    """
    found: set[Target] = set()
    for word in wanted:
        named = _named(word, candidates)
        meant = named or _matching(word, candidates)
        if not meant:
            if elsewhere := _named(word, [*others]) or _matching(word, [*others]):
                text = f"{full_name(elsewhere[0])} {others[elsewhere[0]]}"
                raise OperationError(Code.BAD_ARGUMENTS, text, name=word)
            raise OperationError(
                Code.UNKNOWN_NAME,
                f"no node or process named '{word}'{_proposal(word, candidates)}",
                name=word,
            )
        if len(named) > 1:
            text = f"'{word}' is ambiguous: {listed([*map(str, named)], _LISTED)}"
            raise OperationError(Code.AMBIGUOUS_NAME, text, name=word)
        found.update(meant)
    return [each for each in candidates if each in found]


def meant(
    operation: str,
    names: Sequence[str],
    members: Sequence[Target],
    nodes: Sequence[Target],
    guests: Mapping[Target, str],
) -> list[Target]:
    """Find the units that the names of an operation mean; see `chosen`."""
    others = dict(guests)
    if operation in MEMBER_ACTIONS:
        others |= dict.fromkeys(nodes, "is a composable node; use load, unload or reload")
        return chosen(names, members, others)
    if operation in NODE_ACTIONS:
        others |= dict.fromkeys(members, "is not a composable node; use start, stop or restart")
        return chosen(names, nodes, others)
    return chosen(names, [*members, *nodes], others)


def _named(word: str, candidates: Sequence[Target]) -> list[Target]:
    """Find the units with that full name, or else with that last part."""
    exact = [each for each in candidates if word in {full_name(each), str(each)}]
    return exact or [each for each in candidates if full_name(each).endswith(f"/{word}")]


def _matching(word: str, candidates: Sequence[Target]) -> list[Target]:
    written = str if ":" in word else full_name
    return [each for each in candidates if fnmatchcase(written(each), word)]


def _proposal(word: str, candidates: Sequence[Target]) -> str:
    if _matching(full := f"*/{word}", candidates) and set(word) & _WILD:
        return f"; patterns are over full names: '{full}'"
    if close := similar(word, map(full_name, candidates)):
        return f"; did you mean {close}?"
    return "; play-launch ps lists all names"


# Rows.


def rows_of(view: SystemView, processes: Iterable[str], samples: Samples) -> list[UnitRow]:
    """Make the rows: each container before its nodes, as declared; then the processes.

    ``processes`` are the names of all ordinary processes that are declared: one that was never
    started is in no event.
    """
    rows: list[UnitRow] = []
    for container in view.containers.values():
        rows += _of_container(container, view, samples)
    names = dict.fromkeys([*processes, *view.processes])
    return rows + [_of_process(name, view, samples) for name in names]


def with_groups(rows: Iterable[UnitRow]) -> list[UnitRow]:
    """Add the usage of the control group of each row's process; reads files of the kernel."""
    pids = {row.name: row.pid for row in rows if row.container is None}
    found = []
    for row in rows:
        is_own = row.pid is not None and (
            row.container is None or row.pid != pids.get(row.container)
        )
        group = group_of(row.pid) if is_own and row.pid else None
        found.append(replace(row, cgroup=None if group is None else usage_of(group)))
    return found


def target_of(row: UnitRow) -> Target:
    return NodeKey(row.container, row.name) if row.container else row.name


def status_of(
    row: UnitRow,
    world: World,
    view: SystemView,
    restarts: tuple[RestartRecord, ...],
    output: tuple[LastLine, ...],
) -> UnitStatus | None:
    """Add to a row all that is known of its unit; None: it was removed."""
    unit: Process | Node | None
    seen: ContainerView | ProcessEvent | NodeStateChanged | None
    target = target_of(row)
    if isinstance(target, str):
        unit = world.processes.get(target)
        seen = view.containers.get(target) or view.processes.get(target)
    else:
        unit = world.nodes.get(target)
        container = view.containers.get(target.container)
        seen = container.nodes.get(target) if container else None
    if unit is None:
        return None
    return UnitStatus(
        **{name: getattr(row, name) for name in UnitRow.__struct_fields__},
        since_ns=seen.stamp_ns or None if seen else None,
        last_restarts=restarts,
        waits_for=unit.wait.text if unit.wait else "",
        wanted=is_wanted(world, unit),
        command=unit.argv if isinstance(unit, Process) else (),
        resources=unit.config.resources.described(),
        declared=f"{unit.config.file}:{unit.config.line}" if unit.config.file else "",
        output=output,
    )


def _of_container(
    container: ContainerView, view: SystemView, samples: Samples
) -> Iterator[UnitRow]:
    process = container.process
    sample = samples.get((SubjectKind.CONTAINER, container.name))
    yield UnitRow(
        name=container.name,
        kind="container",
        container=None,
        state=container.state.value,
        reason=container.reason,
        managed=None,
        crashes=container.crashes,
        **_of_life(process),
        **_usage(sample, process.pid),
    )
    for node in container.nodes.values():
        yield _of_node(node, container, view, samples)
    for guest in map(state_of_guest, container.guests.values()):
        yield replace(_of_node(guest, container, view, samples), is_guest=True)


def _of_node(
    node: NodeStateChanged, container: ContainerView, view: SystemView, samples: Samples
) -> UnitRow:
    pid = node.pid if node.state in _HAS_PROCESS and container.process.pid else 0
    # Without a process of its own, its usage is in the numbers of its container.
    is_own = pid not in {0, container.process.pid}
    sample = samples.get((SubjectKind.NODE, str(node.key))) if is_own else None
    return UnitRow(
        name=node.node,
        kind="component",
        container=node.container,
        state=node.state.value,
        reason=node.reason,
        managed=_managed(view, str(node.key)),
        pid=pid or None,
        restarts=node.reloads,
        uptime_s=round((time.time_ns() - node.stamp_ns) / 1e9, 3)
        if node.state is NodeState.LOADED
        else None,
        exit_code=None,
        signal=None,
        crashes=node.crashes,
        **_usage(sample, pid),
    )


def _of_process(name: str, view: SystemView, samples: Samples) -> UnitRow:
    process = view.processes.get(name)
    life: dict[str, Any] = dict.fromkeys(("pid", "uptime_s", "exit_code", "signal")) | {
        "restarts": 0
    }
    return UnitRow(
        name=name,
        kind="process",
        container=None,
        state=_STATE_OF_PROCESS[process.kind] if process else "pending",
        reason=process.message if process else "",
        managed=_managed(view, name),
        crashes=0,
        **_of_life(process) if process else life,
        **_usage(samples.get((SubjectKind.PROCESS, name)), process.pid if process else 0),
    )


def _managed(view: SystemView, unit: str) -> Managed | None:
    found = view.managed.get(unit)
    return Managed(found.state.value, found.reason) if found else None


def _of_life(process: ProcessEvent) -> dict[str, Any]:
    has_ended = process.kind in _ENDED
    is_known = process.exit_code != UNKNOWN_STATUS
    return {
        "pid": process.pid or None,
        "restarts": process.restarts,
        "uptime_s": _age(process.start_time) if process.pid else None,
        "exit_code": process.exit_code if has_ended and is_known else None,
        "signal": process.signal or None if has_ended else None,
    }


def _age(start_time: int) -> float | None:
    """Seconds since a number of clock ticks after the boot; None if unknown."""
    now = time.clock_gettime(time.CLOCK_BOOTTIME)
    return round(max(now - start_time / _TICKS, 0.0), 3) if start_time else None


def _usage(sample: ProcessSample | None, pid: int) -> dict[str, Any]:
    if (
        sample is None
        or sample.pid != pid
        or time.time_ns() - sample.stamp_ns > _SAMPLE_AGE_LIMIT_NS
    ):
        return {"cpu_percent": None, "memory_bytes": None, "memory_kind": None}
    # Memory that is shared with the container is not the node's own.
    is_shared = sample.memory_kind is MemoryKind.SHARED
    return {
        "cpu_percent": round(sample.cpu_percent, 2),
        "memory_bytes": None if is_shared else sample.memory_bytes,
        "memory_kind": sample.memory_kind.name.lower(),
    }
