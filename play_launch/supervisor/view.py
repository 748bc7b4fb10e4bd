"""The whole run as it stands, folded from its events.

Views are immutable: ``view.after(event)`` is a new one. The live display, the summary and the exit
code read nothing else, so all of them can be made from a recording as well.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol, TypeVar

from msgspec import Struct, field
from msgspec.structs import replace

from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import (
    UNDER_WAY,
    ActionEvent,
    ActionPhase,
    ContainerState,
    ContainerStateChanged,
    ManagedNodeChanged,
    ManagedState,
    NodeState,
    NodeStateChanged,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
    SubjectKind,
    Withdrawn,
)

if TYPE_CHECKING:
    from collections.abc import Mapping


_Key = TypeVar("_Key")
_Value = TypeVar("_Value")

FAILED_STATES = frozenset({NodeState.LOAD_FAILED, NodeState.CRASHED, NodeState.GAVE_UP})
DISMISSING = frozenset({"stop", "unload"})
"""Actions whose targets are not expected to run afterwards."""
RECALLING = frozenset({"start", "restart", "load", "reload", "apply"})
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
    start_time: int = 0
    """Of that process, in clock ticks after boot; 0 where unknown."""
    unique_id: int = 0
    crashes: int = 0
    reloads: int = 0

    @property
    def container(self) -> str:
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
    start_time: int = 0
    """In clock ticks after boot; of the process that ran at last."""
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
    def waiting(self) -> bool:
        """Whether it was not started yet, because of what it depends on."""
        return self.kind is ProcessEventKind.WAITING

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
        return len(self.nodes)

    @property
    def loaded(self) -> int:
        return sum(node.state is NodeState.LOADED for node in self.nodes.values())

    @property
    def waiting(self) -> tuple[NodeView, ...]:
        return tuple(node for node in self.nodes.values() if node.state in WAITING_STATES)

    @property
    def unloaded(self) -> tuple[NodeView, ...]:
        """The nodes that were unloaded, or are being unloaded, and are not loaded again."""
        unloaded = {NodeState.UNLOADING, NodeState.UNLOADED}
        return tuple(node for node in self.nodes.values() if node.state in unloaded)

    @property
    def failed(self) -> tuple[NodeView, ...]:
        return tuple(node for node in self.nodes.values() if node.state in FAILED_STATES)

    @property
    def crashes(self) -> int:
        return sum(node.crashes for node in self.nodes.values())

    def crashed_since(self, before: ContainerView) -> tuple[NodeView, ...]:
        """Its nodes that crashed after it was as ``before``, reloaded or not."""
        return tuple(
            node
            for key, node in self.nodes.items()
            if key in before.nodes and node.crashes > before.nodes[key].crashes
        )

    def without(self, keys: frozenset[str]) -> ContainerView:
        left = {key: node for key, node in self.nodes.items() if str(key) not in keys}
        return replace(self, nodes=MappingProxyType(left))


class SystemView(Struct, frozen=True, kw_only=True):
    """Containers and ordinary processes by full name."""

    containers: Mapping[str, ContainerView] = field(default_factory=lambda: MappingProxyType({}))
    processes: Mapping[str, ProcessView] = field(default_factory=lambda: MappingProxyType({}))
    managed: Mapping[str, ManagedNodeChanged] = field(default_factory=lambda: MappingProxyType({}))
    """The latest state of each managed node that is brought somewhere, by unit."""
    dismissed: frozenset[str] = frozenset()
    """What an operator stopped or unloaded and has not requested since: containers and processes
    by name, composable nodes by key."""

    @property
    def expected(self) -> SystemView:
        """The same without what an operator dismissed; a container includes its nodes."""
        if not self.dismissed:
            return self
        containers = {
            name: each.without(self.dismissed)
            for name, each in self.containers.items()
            if name not in self.dismissed
        }
        processes = {
            name: each for name, each in self.processes.items() if name not in self.dismissed
        }
        managed = {
            unit: each
            for unit, each in self.managed.items()
            if self.dismissed.isdisjoint({unit, unit.partition(":")[0]})
        }
        return SystemView(
            containers=MappingProxyType(containers),
            processes=MappingProxyType(processes),
            managed=MappingProxyType(managed),
        )

    @property
    def loaded(self) -> int:
        return sum(container.loaded for container in self.containers.values())

    @property
    def total(self) -> int:
        return sum(container.total for container in self.containers.values())

    @property
    def waiting(self) -> tuple[NodeView, ...]:
        return tuple(node for each in self.containers.values() for node in each.waiting)

    @property
    def unloaded(self) -> tuple[NodeView, ...]:
        return tuple(node for each in self.containers.values() for node in each.unloaded)

    @property
    def is_complete(self) -> bool:
        """Whether all that is declared is there: containers run, nodes are loaded.

        An ordinary process that has ended has done its work; one that waits for its start, or
        restart, has not.
        """
        running = all(each.state is ContainerState.RUNNING for each in self.containers.values())
        waiting = any(each.restarting or each.waiting for each in self.processes.values())
        under_way = any(each.state in UNDER_WAY for each in self.managed.values())
        return running and not waiting and not under_way and self.loaded == self.total

    @property
    def failed(self) -> tuple[NodeView, ...]:
        return tuple(node for each in self.containers.values() for node in each.failed)

    @property
    def crashed(self) -> tuple[NodeView, ...]:
        """All nodes that crashed at least once, reloaded or not."""
        nodes = (node for each in self.containers.values() for node in each.nodes.values())
        return tuple(node for node in nodes if node.crashes)

    @property
    def gave_up(self) -> tuple[str, ...]:
        """Names of the containers that are not started again."""
        return tuple(
            each.name for each in self.containers.values() if each.state is ContainerState.GAVE_UP
        )

    @property
    def failed_managed(self) -> tuple[ManagedNodeChanged, ...]:
        return tuple(each for each in self.managed.values() if each.state is ManagedState.FAILED)

    @property
    def failed_processes(self) -> tuple[ProcessView, ...]:
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
            case ManagedNodeChanged():
                return replace(self, managed=_with(self.managed, event.unit, event))
            case ActionEvent(phase=ActionPhase.REQUESTED):
                return self._asked(event)
            case Withdrawn():
                return self._without(event)
            case _:
                return self

    def _asked(self, event: ActionEvent) -> SystemView:
        """Note the request of an operator: a dismissed unit is so until it is requested again."""
        dismissed = self.dismissed
        if event.action in DISMISSING:
            dismissed |= {*event.targets}
        elif event.action in RECALLING:
            dismissed -= {*event.targets}
        return self if dismissed == self.dismissed else replace(self, dismissed=dismissed)

    def _without(self, event: Withdrawn) -> SystemView:
        view = self
        match event.kind:
            case SubjectKind.CONTAINER:
                view = replace(self, containers=_less(self.containers, event.key))
            case SubjectKind.PROCESS:
                view = replace(self, processes=_less(self.processes, event.key))
            case SubjectKind.NODE:
                key = NodeKey.parsed(event.key)
                if (container := self.containers.get(key.container)) is not None:
                    nodes = _less(container.nodes, key)
                    view = self._with_container(replace(container, nodes=nodes))
        return replace(view, dismissed=self.dismissed - {event.key})

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
        start_time=event.start_time,
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
        ProcessEventKind.WAITING,
        ProcessEventKind.STOPPED,
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
        start_time=event.start_time,
        exit_code=event.exit_code if ended else process.exit_code,
        signal=event.signal if ended else process.signal,
        restarts=event.restarts,
        message=process.message if gave_up else event.message,
    )


def _with(mapping: Mapping[_Key, _Value], key: _Key, value: _Value) -> Mapping[_Key, _Value]:
    return MappingProxyType({**mapping, key: value})


def _less(mapping: Mapping[_Key, _Value], key: _Key) -> Mapping[_Key, _Value]:
    return MappingProxyType({each: value for each, value in mapping.items() if each != key})


class StateSink(Protocol):
    """Takes what happens, with the view of before and after; never blocks, in the loop's thread."""

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        """Take one event; the views are the same object where it changes nothing."""


_NOT_RUNNING = frozenset({ContainerState.STOPPED, ContainerState.GAVE_UP})
_NOT_UP = frozenset({ContainerState.STOPPED, ContainerState.STARTING})
_NOT_LOADED = FAILED_STATES | {NodeState.UNLOADED}


def is_up(view: SystemView) -> bool:
    """Whether all containers were started and all loads are done, well or not."""
    return not view.waiting and all(each.state not in _NOT_UP for each in view.containers.values())


def absent(view: SystemView) -> dict[str, str]:
    """Name the declared units that do not exist and are not going to be started, with the reason.

    A process that exited with status 0 is not named, nor are the nodes of a container that does
    not run, as they are loaded when it is started.
    """
    found: dict[str, str] = {}
    for container in view.containers.values():
        if container.state in _NOT_RUNNING:
            found[container.name] = _said(container.state, container.reason)
            continue
        for key, node in container.nodes.items():
            if node.state in _NOT_LOADED:
                found[str(key)] = _said(node.state, node.reason)
    for process in view.processes.values():
        if process.name in view.dismissed and not process.pid:
            found[process.name] = "it was stopped"
        elif process.failed:
            found[process.name] = process.message or "it has failed"
    return found


def _said(state: NodeState | ContainerState, reason: str) -> str:
    return f"{state}: {reason}" if reason else str(state)
