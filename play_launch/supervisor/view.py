"""The whole run as it stands, folded from its events.

Views are immutable: ``view.after(event)`` is a new one. The live display, the summary and the exit
code read nothing else, so all of them can be made from a recording as well.
"""

from __future__ import annotations

from itertools import chain
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

from msgspec import Struct, field
from msgspec.structs import replace

from play_launch import ExitCode
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import (
    ComponentEvent,
    ComponentEventKind,
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
    WantChanged,
    Withdrawn,
)
from play_launch.supervisor.outcome import ENDING_SIGNALS, Cause

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping


_Key = TypeVar("_Key")
_Value = TypeVar("_Value")

_FAILED = frozenset({NodeState.LOAD_FAILED, NodeState.CRASHED, NodeState.GAVE_UP})
UNDER_WAY: Final = frozenset(
    {ManagedState.ASKED, ManagedState.CONFIGURING, ManagedState.ACTIVATING}
)
"""States of a managed node that end with an answer or its timeout."""
_WAITING = frozenset({NodeState.PENDING, NodeState.REQUESTED, NodeState.LOADING, NodeState.LOST})
_TO_START = frozenset({ProcessEventKind.RESTARTING, ProcessEventKind.WAITING})
_ALIVE = frozenset({ProcessEventKind.STARTED, ProcessEventKind.READY, ProcessEventKind.STOPPING})


def _empty() -> Mapping[Any, Any]:
    return MappingProxyType({})


def has_ended_well(process: ProcessEvent) -> bool:
    """Whether a process exited with status 0, and is not started again."""
    has_exited = process.kind is ProcessEventKind.EXITED
    return has_exited and process.exit_code == 0 and process.signal == 0


def has_failed(process: ProcessEvent) -> bool:
    """Whether a process exited otherwise, unrequested, or is not started again."""
    if process.kind is ProcessEventKind.GAVE_UP:
        return True
    is_requested = process.cause is Cause.STOPPED
    has_exited = process.kind is ProcessEventKind.EXITED
    return has_exited and not is_requested and not has_ended_well(process)


def is_guest(unique_id: int, attempt: int) -> bool:
    """Whether another program loaded a node, as `ros2 component load` does: by no attempt of ours.

    Without a ``unique_id`` the container itself is meant, or a load that was not accepted.
    """
    return bool(unique_id) and not attempt


class _Nodes(Struct, frozen=True, kw_only=True):
    """What a view tells of its composable nodes."""

    def _all(self) -> Iterable[NodeStateChanged]:
        raise NotImplementedError

    def _in(self, states: Collection[NodeState]) -> tuple[NodeStateChanged, ...]:
        return tuple(node for node in self._all() if node.state in states)

    @property
    def total(self) -> int:
        return sum(1 for _ in self._all())

    @property
    def loaded(self) -> int:
        return len(self._in({NodeState.LOADED}))

    @property
    def waiting(self) -> tuple[NodeStateChanged, ...]:
        return self._in(_WAITING)

    @property
    def unloaded(self) -> tuple[NodeStateChanged, ...]:
        """The nodes that were unloaded, or are being unloaded, and are not loaded again."""
        return self._in({NodeState.UNLOADING, NodeState.UNLOADED})

    @property
    def failed(self) -> tuple[NodeStateChanged, ...]:
        return self._in(_FAILED)

    @property
    def crashes(self) -> int:
        return sum(node.crashes for node in self._all())

    @property
    def crashed(self) -> tuple[NodeStateChanged, ...]:
        """All nodes that crashed at least once, reloaded or not."""
        return tuple(node for node in self._all() if node.crashes)


class ContainerView(_Nodes, frozen=True, kw_only=True):
    """One container and its nodes, in the order in which they were announced: as declared."""

    name: str
    state: ContainerState = ContainerState.STOPPED
    stamp_ns: int = 0
    """When it came to this state."""
    reason: str = ""
    mechanism: str = ""
    """How its nodes are isolated; empty where they are not, or while it does not run."""
    process: ProcessEvent
    """The latest of its process, as in `SystemView.processes`."""
    nodes: Mapping[NodeKey, NodeStateChanged] = field(default_factory=_empty)
    """The latest state of each node; its stamp is that of the first event with that state."""
    guests: Mapping[str, ComponentEvent] = field(default_factory=_empty)
    """Nodes by name that other programs have loaded; they count nowhere."""

    def _all(self) -> Iterable[NodeStateChanged]:
        return self.nodes.values()

    def crashed_since(self, before: ContainerView) -> tuple[NodeStateChanged, ...]:
        """Its nodes that crashed after it was as ``before``, reloaded or not."""
        return tuple(
            node
            for key, node in self.nodes.items()
            if key in before.nodes and node.crashes > before.nodes[key].crashes
        )


class SystemView(_Nodes, frozen=True, kw_only=True):
    """Containers and ordinary processes by full name."""

    containers: Mapping[str, ContainerView] = field(default_factory=_empty)
    processes: Mapping[str, ProcessEvent] = field(default_factory=_empty)
    """The latest event of each; without a pid when it does not run, with the latest exit."""
    managed: Mapping[str, ManagedNodeChanged] = field(default_factory=_empty)
    """The latest state of each managed node that is brought somewhere, by unit."""
    dismissed: frozenset[str] = frozenset()
    """What an operator stopped or unloaded and has not requested since: containers and processes
    by name, composable nodes by key."""

    @property
    def expected(self) -> SystemView:
        """The same without what an operator dismissed; a container includes its nodes."""
        gone = self.dismissed
        containers = _less(self.containers, gone)
        managed = {unit: each for unit, each in self.managed.items() if unit not in gone}
        return SystemView(
            containers={
                name: replace(each, nodes=_less(each.nodes, gone))
                for name, each in containers.items()
            },
            processes=_less(self.processes, gone),
            managed={u: each for u, each in managed.items() if u.partition(":")[0] not in gone},
        )

    def _all(self) -> Iterable[NodeStateChanged]:
        return chain.from_iterable(each.nodes.values() for each in self.containers.values())

    @property
    def is_complete(self) -> bool:
        """Whether all that is declared is there: containers run, nodes are loaded.

        An ordinary process that has ended has done its work; one that waits for its start, or
        restart, has not.
        """
        running = all(each.state is ContainerState.RUNNING for each in self.containers.values())
        waiting = any(each.kind in _TO_START for each in self.processes.values())
        under_way = any(each.state in UNDER_WAY for each in self.managed.values())
        return running and not waiting and not under_way and self.loaded == self.total

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
    def failed_processes(self) -> tuple[ProcessEvent, ...]:
        return tuple(each for each in self.processes.values() if has_failed(each))

    def after(self, event: RunEvent) -> SystemView:
        """Give the view that follows; the same object when the event changes nothing."""
        match event:
            case NodeStateChanged():
                return self._with_container(_node_changed(self._container(event.container), event))
            case ComponentEvent() if is_guest(event.unique_id, event.attempt):
                container = self._container(event.container)
                guests = _less(container.guests, {event.full_node_name})
                if event.kind is ComponentEventKind.LOADED:
                    guests = _with(guests, event.full_node_name, event)
                return self._with_container(replace(container, guests=guests))
            case ContainerStateChanged():
                container = self._container(event.container)
                container = replace(
                    container,
                    guests=container.guests if event.state is ContainerState.RUNNING else _empty(),
                    state=event.state,
                    stamp_ns=event.stamp_ns,
                    reason=event.reason,
                    mechanism=event.mechanism,
                )
                return self._with_container(container)
            case ProcessEvent() if event.name in self.containers:
                container = self.containers[event.name]
                process = _process_changed(container.process, event)
                return self._with_container(replace(container, process=process))
            case ProcessEvent():
                process = _process_changed(self.processes.get(event.name), event)
                return replace(self, processes=_with(self.processes, event.name, process))
            case ManagedNodeChanged():
                return replace(self, managed=_with(self.managed, event.unit, event))
            case WantChanged():
                unit = {event.unit}
                gone = self.dismissed - unit if event.is_wanted else self.dismissed | unit
                return replace(self, dismissed=gone)
            case Withdrawn():
                return self._without(event)
            case _:
                return self

    def _without(self, event: Withdrawn) -> SystemView:
        match event.kind:
            case SubjectKind.CONTAINER:
                return replace(self, containers=_less(self.containers, {event.key}))
            case SubjectKind.PROCESS:
                return replace(self, processes=_less(self.processes, {event.key}))
        container = self.containers.get(NodeKey.parsed(event.key).container)
        if container is None:
            return self
        nodes = _less(container.nodes, {event.key})
        return self._with_container(replace(container, nodes=nodes))

    def _container(self, name: str) -> ContainerView:
        if (known := self.containers.get(name)) is not None:
            return known
        never = ProcessEvent(stamp_ns=0, name=name, kind=ProcessEventKind.STARTED)
        return ContainerView(name=name, process=never)

    def _with_container(self, container: ContainerView) -> SystemView:
        return replace(self, containers=_with(self.containers, container.name, container))


def _node_changed(container: ContainerView, event: NodeStateChanged) -> ContainerView:
    before = container.nodes.get(event.key)
    if before is not None and before.state is event.state:
        event = replace(event, stamp_ns=before.stamp_ns)
    return replace(container, nodes=_with(container.nodes, event.key, event))


def _process_changed(before: ProcessEvent | None, event: ProcessEvent) -> ProcessEvent:
    """Keep what later events do not repeat: how it exited, and that it was given up."""
    if before is None:
        before = ProcessEvent(stamp_ns=0, name=event.name, kind=event.kind)
    has_exited = event.kind is ProcessEventKind.EXITED
    # Given up while it still ran: its end does not change that.
    stays = before.kind is ProcessEventKind.GAVE_UP and (
        has_exited or event.kind is ProcessEventKind.STOPPING
    )
    exit_of = event if has_exited else before
    shown = before if stays else event
    return replace(
        event,
        kind=shown.kind,
        message=shown.message,
        pid=event.pid if event.kind in _ALIVE else 0,
        exit_code=exit_of.exit_code,
        signal=exit_of.signal,
    )


def _with(mapping: Mapping[_Key, _Value], key: _Key, value: _Value) -> Mapping[_Key, _Value]:
    return MappingProxyType({**mapping, key: value})


def _less(mapping: Mapping[_Key, _Value], gone: Collection[str]) -> Mapping[_Key, _Value]:
    return MappingProxyType({key: each for key, each in mapping.items() if str(key) not in gone})


class StateSink(Protocol):
    """Takes what happens, with the view of before and after; never blocks, in the loop's thread."""

    def publish(self, event: RunEvent, before: SystemView, after: SystemView) -> None:
        """Take one event; the views are the same object where it changes nothing."""


_NOT_UP = frozenset({ContainerState.STOPPED, ContainerState.STARTING})


def is_up(view: SystemView) -> bool:
    """Whether all containers were started and all loads are done, well or not."""
    return not view.waiting and all(each.state not in _NOT_UP for each in view.containers.values())


def exit_code(view: SystemView, final: SystemView, signum: int | None) -> int:
    """Give the exit code of a run; docs/control.md#exit-codes explains it.

    Args:
        view: The system at the moment in which the run began to end, so before it was stopped.
        final: The system after that.
        signum: The signal that ended the run; None for another end.
    """
    if signum is not None:
        return ExitCode.SIGNAL_BASE + signum
    expected = view.expected
    if expected.failed or expected.gave_up or expected.failed_processes or expected.failed_managed:
        return ExitCode.NODE_FAILED
    if crashed_while_stopped(view, final):
        return ExitCode.NODE_FAILED
    if not expected.is_complete:
        return ExitCode.NODES_MISSING
    return ExitCode.OK


def crashed_while_stopped(view: SystemView, final: SystemView) -> list[str]:
    """Name what ran when the end began, and crashed before it had stopped; see `exit_code`."""
    both = [(each, final.containers.get(name)) for name, each in view.containers.items()]
    containers = [(before, after) for before, after in both if after is not None]
    processes = [(before.process, after.process) for before, after in containers]
    processes += [
        (before, final.processes[name])
        for name, before in view.processes.items()
        if name in final.processes
    ]
    return [
        *(
            before.name
            for before, after in processes
            if before.pid
            and after.kind is ProcessEventKind.EXITED
            and after.signal
            and after.signal not in ENDING_SIGNALS
        ),
        *(str(node.key) for before, after in containers for node in after.crashed_since(before)),
    ]
