"""Which processes of a system are measured."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.supervisor.events import NodeState, SubjectKind

if TYPE_CHECKING:
    from play_launch.supervisor.view import ContainerView, SystemView

_HAS_A_PROCESS: Final = frozenset({NodeState.LOADING, NodeState.LOADED, NodeState.UNLOADING})
_SHARES_MEMORY: Final = "shared_memory"


class Target(Struct, frozen=True):
    """One process to be measured, and what it is the process of."""

    kind: SubjectKind
    key: str
    pid: int
    start_time: int
    """Clock ticks after boot; 0 where that is not known."""
    memory_of: int = 0
    """The pid of the container whose memory and descriptors it shares; 0: it has its own."""


def targets(view: SystemView) -> list[Target]:
    """List the processes that should be alive now, containers before their nodes."""
    found: list[Target] = []
    for container in view.containers.values():
        found += _of_container(container)
    found += [
        Target(SubjectKind.PROCESS, each.name, each.pid, each.start_time)
        for each in view.processes.values()
        if each.pid
    ]
    return found


def _of_container(container: ContainerView) -> list[Target]:
    process = container.process
    if not process.pid:
        return []
    own = Target(SubjectKind.CONTAINER, container.name, process.pid, process.start_time)
    if not container.mechanism:
        # Its nodes are no processes; or it stops, and whose memory theirs is is not known any more.
        return [own]
    memory_of = process.pid if container.mechanism == _SHARES_MEMORY else 0
    nodes = [
        Target(SubjectKind.NODE, str(node.key), node.pid, node.start_time, memory_of)
        for node in container.nodes.values()
        if node.state in _HAS_A_PROCESS and node.pid not in (0, process.pid)
    ]
    return [own, *nodes]
