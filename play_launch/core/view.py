"""The whole run as it stands, folded from its events.

Views are immutable: ``view.after(event)`` is a new one. The live display, the summary and the exit
code read nothing else, so all of them can be made from a recording as well.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol, TypeVar

from msgspec import Struct, field
from msgspec.structs import replace

from play_launch.core.events import (
    ContainerState,
    ContainerStateChanged,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.core.node_key import NodeKey

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")

FAILED_STATES = frozenset({NodeState.LOAD_FAILED, NodeState.CRASHED, NodeState.GAVE_UP})
WAITING_STATES = frozenset(
    {NodeState.PENDING, NodeState.REQUESTED, NodeState.LOADING, NodeState.LOST}
)


class NodeView(Struct, frozen=True, kw_only=True):
    """One declared composable node."""

    key: NodeKey
    state: NodeState
    since_ns: int
    """Wall-clock time since which it is in this state, nanoseconds since the epoch."""
    elapsed_ns: int = 0
    reason: str = ""
    pid: int = 0
    """Of the process that holds it, or held it at last."""
    unique_id: int = 0
    crashes: int = 0
    reloads: int = 0

    @property
    def container(self) -> str:
        """Full name of its container."""
        return self.key.container

    @property
    def node(self) -> str:
        """Declared full name, or the label of a node that has none."""
        return self.key.name


class ProcessView(Struct, frozen=True, kw_only=True):
    """One process that the supervisor owns."""

    name: str
    kind: ProcessEventKind = ProcessEventKind.STARTED
    """The latest thing that happened to it."""
    since_ns: int = 0
    pid: int = 0
    """0 when it does not run."""
    exit_code: int = 0
    signal: int = 0
    restarts: int = 0
    message: str = ""

    @property
    def ended_well(self) -> bool:
        """Whether it ended with status 0 and stays so."""
        ended = self.kind is ProcessEventKind.EXITED
        return ended and self.exit_code == 0 and self.signal == 0

    @property
    def restarting(self) -> bool:
        """Whether it waits for its restart, so that it is not there at the moment."""
        return self.kind is ProcessEventKind.RESTARTING

    @property
    def failed(self) -> bool:
        """Whether it ended otherwise than with status 0, or is not started again."""
        if self.kind is ProcessEventKind.GAVE_UP:
            return True
        return self.kind is ProcessEventKind.EXITED and not self.ended_well


class ContainerView(Struct, frozen=True, kw_only=True):
    """One container and its nodes, in the order in which they were announced: as declared."""

    name: str
    state: ContainerState = ContainerState.STOPPED
    since_ns: int = 0
    reason: str = ""
    mechanism: str = ""
    """How its nodes are isolated; empty where they are not, or while it does not run."""
    process: ProcessView
    nodes: Mapping[NodeKey, NodeView] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def total(self) -> int:
        """How many nodes are declared."""
        return len(self.nodes)

    @property
    def loaded(self) -> int:
        """How many of them are loaded."""
        return sum(node.state is NodeState.LOADED for node in self.nodes.values())

    @property
    def waiting(self) -> tuple[NodeView, ...]:
        """The nodes that are not there yet, or not any more but may come back."""
        return tuple(node for node in self.nodes.values() if node.state in WAITING_STATES)

    @property
    def unloaded(self) -> tuple[NodeView, ...]:
        """The nodes that were unloaded, or are being unloaded: nobody is going to load them."""
        unloaded = {NodeState.UNLOADING, NodeState.UNLOADED}
        return tuple(node for node in self.nodes.values() if node.state in unloaded)

    @property
    def failed(self) -> tuple[NodeView, ...]:
        """The nodes that failed to load, or crashed."""
        return tuple(node for node in self.nodes.values() if node.state in FAILED_STATES)

    @property
    def crashes(self) -> int:
        """How often its nodes crashed."""
        return sum(node.crashes for node in self.nodes.values())


class SystemView(Struct, frozen=True, kw_only=True):
    """Containers and ordinary processes by full name."""

    containers: Mapping[str, ContainerView] = field(default_factory=lambda: MappingProxyType({}))
    processes: Mapping[str, ProcessView] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def loaded(self) -> int:
        """How many composable nodes are loaded."""
        return sum(container.loaded for container in self.containers.values())

    @property
    def total(self) -> int:
        """How many composable nodes are declared."""
        return sum(container.total for container in self.containers.values())

    @property
    def waiting(self) -> tuple[NodeView, ...]:
        """All nodes that are not there (yet)."""
        return tuple(node for each in self.containers.values() for node in each.waiting)

    @property
    def unloaded(self) -> tuple[NodeView, ...]:
        """All nodes that were unloaded, or are being unloaded."""
        return tuple(node for each in self.containers.values() for node in each.unloaded)

    @property
    def is_complete(self) -> bool:
        """Whether all that is declared is there: containers run, nodes are loaded.

        An ordinary process that has ended has done its work; one that waits for its restart has
        not.
        """
        running = all(each.state is ContainerState.RUNNING for each in self.containers.values())
        waiting = any(each.restarting for each in self.processes.values())
        return running and not waiting and self.loaded == self.total

    @property
    def failed(self) -> tuple[NodeView, ...]:
        """All nodes that failed to load, or crashed."""
        return tuple(node for each in self.containers.values() for node in each.failed)

    @property
    def crashed(self) -> tuple[NodeView, ...]:
        """All nodes that crashed at least once, whatever became of them."""
        nodes = (node for each in self.containers.values() for node in each.nodes.values())
        return tuple(node for node in nodes if node.crashes)

    @property
    def gave_up(self) -> tuple[str, ...]:
        """Names of the containers that are not started again."""
        return tuple(
            each.name for each in self.containers.values() if each.state is ContainerState.GAVE_UP
        )

    @property
    def failed_processes(self) -> tuple[ProcessView, ...]:
        """The ordinary processes that failed."""
        return tuple(each for each in self.processes.values() if each.failed)

    def after(self, event: RunEvent) -> SystemView:
        """Give the view that follows; the same object when the event changes nothing."""
        match event:
            case NodeStateChanged():
                return self._with_container(_node_changed(self._container(event.container), event))
            case ContainerStateChanged():
                container = self._container(event.container)
                return self._with_container(
                    replace(
                        container,
                        state=event.state,
                        since_ns=event.stamp_ns,
                        reason=event.reason,
                        mechanism=event.mechanism,
                    )
                )
            case ProcessEvent() if event.name in self.containers:
                container = self.containers[event.name]
                process = _process_changed(container.process, event)
                return self._with_container(replace(container, process=process))
            case ProcessEvent():
                process = self.processes.get(event.name, ProcessView(name=event.name))
                changed = _with(self.processes, event.name, _process_changed(process, event))
                return replace(self, processes=changed)
            case _:
                return self

    def _container(self, name: str) -> ContainerView:
        known = self.containers.get(name)
        return known or ContainerView(name=name, process=ProcessView(name=name))

    def _with_container(self, container: ContainerView) -> SystemView:
        return replace(self, containers=_with(self.containers, container.name, container))


def _node_changed(container: ContainerView, event: NodeStateChanged) -> ContainerView:
    before = container.nodes.get(event.key)
    repeated = before is not None and before.state is event.state
    node = NodeView(
        key=event.key,
        state=event.state,
        since_ns=before.since_ns if repeated and before else event.stamp_ns,
        elapsed_ns=event.elapsed_ns,
        reason=event.reason,
        pid=event.pid,
        unique_id=event.unique_id,
        crashes=event.crashes,
        reloads=event.reloads,
    )
    return replace(container, nodes=_with(container.nodes, event.key, node))


def _process_changed(process: ProcessView, event: ProcessEvent) -> ProcessView:
    alive = event.kind not in {
        ProcessEventKind.EXITED,
        ProcessEventKind.RESTARTING,
        ProcessEventKind.GAVE_UP,
    }
    ended = event.kind is ProcessEventKind.EXITED
    # Given up while it still ran: its end does not change that.
    ends = event.kind in {ProcessEventKind.STOPPING, ProcessEventKind.EXITED}
    gave_up = process.kind is ProcessEventKind.GAVE_UP and ends
    return replace(
        process,
        kind=process.kind if gave_up else event.kind,
        since_ns=event.stamp_ns,
        pid=event.pid if alive else 0,
        exit_code=event.exit_code if ended else process.exit_code,
        signal=event.signal if ended else process.signal,
        restarts=event.restarts,
        message=process.message if gave_up else event.message,
    )


def _with(mapping: Mapping[_Key, _Value], key: _Key, value: _Value) -> Mapping[_Key, _Value]:
    return MappingProxyType({**mapping, key: value})


class StateSink(Protocol):
    """Takes what happens, with the view of before and after; never blocks, in the loop's thread."""

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        """Take one event; the views are the same object where it changes nothing."""
