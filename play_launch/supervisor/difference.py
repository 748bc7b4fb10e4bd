"""Events as the difference of two worlds: the only source of what is published about a system."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import asdict, replace

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
    SubjectKind,
    WantChanged,
    Withdrawn,
)
from play_launch.supervisor.inputs import ProbeResult
from play_launch.supervisor.outcome import Outcome
from play_launch.supervisor.world import STATE_OF_PHASE, Before, Phase

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.world import Goal, Node, Process, World

_TIMED: Final = frozenset(
    {NodeState.REQUESTED, NodeState.LOADING, NodeState.LOADED, NodeState.LOAD_FAILED}
)
"""States that are reported with the time since the load was sent."""


def events_since(world: World, *, now: float, stamp_ns: int) -> Iterator[RunEvent]:
    """Give the events of what has changed since the last call, in the order of publication."""
    before, world.before = world.before, Before({}, {}, {}, world.dismissed)
    for unit in sorted(before.dismissed ^ world.dismissed):
        yield WantChanged(stamp_ns=stamp_ns, unit=unit, is_wanted=unit in before.dismissed)
    processes: list[tuple[Process | None, Process]] = []
    for name in sorted(before.processes, key=world.places.__getitem__):
        was, process = before.processes[name], world.processes.get(name)
        if was is not None and (process is None or _kind(was) is not _kind(process)):
            yield Withdrawn(stamp_ns=stamp_ns, kind=_kind(was), key=name)
            was = None
        if process is not None:
            processes.append((was, process))
            yield from _process(was, process, stamp_ns)
    requested = []
    for key in sorted(before.nodes, key=world.places.__getitem__):
        old, node = before.nodes[key], world.nodes.get(key)
        if node is not None and node.state is NodeState.REQUESTED:
            requested.append(node)
        elif node is not None:
            yield from _node(old, node, now, stamp_ns)
        elif old is not None:
            is_unloaded = old.state is NodeState.UNLOADING and key.container in world.processes
            if is_unloaded:  # it is forgotten as soon as it is unloaded
                unloaded = replace(old, state=NodeState.UNLOADED, reason="")
                yield from _node(old, unloaded, now, stamp_ns)
            yield Withdrawn(stamp_ns=stamp_ns, kind=SubjectKind.NODE, key=str(key))
    for was, process in processes:
        yield from _after_nodes(was, process, stamp_ns)
    for node in requested:  # their causes are published first
        yield from _node(before.nodes[node.key], node, now, stamp_ns)
    for name in sorted(before.goals):
        yield from _goal_events(before.goals[name], world.goals.get(name), stamp_ns)


def _kind(process: Process) -> SubjectKind:
    return SubjectKind.PROCESS if process.container is None else SubjectKind.CONTAINER


def _goal_events(old: Goal | None, new: Goal | None, stamp_ns: int) -> Iterator[RunEvent]:
    # What is only watched is not published.
    is_driven = new is not None and new.config.autostart is not None
    before = old.state if old is not None and old.config.autostart else ManagedState.ABSENT
    state = new.state if new is not None and is_driven else ManagedState.ABSENT
    goal = new or old
    if goal is not None and state is not before:
        yield ManagedNodeChanged(
            stamp_ns=stamp_ns,
            unit=goal.unit,
            node=goal.config.name,
            state=state,
            reason=goal.reason if is_driven else "",
        )


def _process(old: Process | None, new: Process, stamp_ns: int) -> Iterator[RunEvent]:
    is_new = old is None or old.attempt != new.attempt
    if new.is_started and (old is None or is_new or not old.is_started):
        yield _event(new, ProcessEventKind.STARTED, stamp_ns, command=new.argv)
    if new.exit is not None and (old is None or is_new or old.exit is None):
        because = f"{new.killed_because}; " if new.killed_because else ""
        yield _event(
            new,
            ProcessEventKind.EXITED,
            stamp_ns,
            message=f"{because}{new.exit.text}",
            exit_code=new.exit.code,
            signal=new.exit.signal,
            restarts=(old or new).restarts.total,
            outcome=new.outcome if new.outcome.cause is new.exit_cause else Outcome(new.exit_cause),
        )
    text = _new_wait(old, new)
    if new.container is None:
        return
    state = STATE_OF_PHASE[new.phase]
    if text or old is None or STATE_OF_PHASE[old.phase] is not state:
        yield ContainerStateChanged(
            stamp_ns=stamp_ns,
            container=new.name,
            state=state,
            reason=text or new.reason,
            mechanism=new.hello.mechanism if new.hello and state is ContainerState.RUNNING else "",
            **asdict(new.outcome),
        )


def _after_nodes(old: Process | None, new: Process, stamp_ns: int) -> Iterator[RunEvent]:
    """Give the events that are published after those of the nodes of a container."""
    if new.container is None and (text := _new_wait(old, new)):
        yield _event(new, ProcessEventKind.WAITING, stamp_ns, text)
    before = Phase.STOPPED if old is None else old.phase
    if new.stopped and not (old and old.stopped and old.attempt == new.attempt):
        yield _event(new, ProcessEventKind.STOPPING, stamp_ns, new.reason)
    if new.phase is before:
        return
    match new.phase:
        case Phase.RUNNING if new.hello is not None:
            yield _event(new, ProcessEventKind.READY, stamp_ns, new.hello.description)
        case Phase.KILLING:
            message = f"killed: {new.killed_because}"
            yield _event(new, ProcessEventKind.STOPPING, stamp_ns, message)
        case Phase.BACKOFF:
            yield _event(new, ProcessEventKind.RESTARTING, stamp_ns, new.reason)
        case Phase.GAVE_UP:
            yield _event(new, ProcessEventKind.GAVE_UP, stamp_ns, new.reason)
        case Phase.STOPPED if new.container is None and before in {Phase.BACKOFF, Phase.QUEUED}:
            # Without an exit to report, it would be shown as waiting for its start.
            yield _event(new, ProcessEventKind.STOPPED, stamp_ns, new.reason)
        case _:
            pass


def _new_wait(old: Process | Node | None, new: Process | Node) -> str:
    """Describe what a unit waits for; empty unless that has changed."""
    if new.wait is None or not new.wait.text:
        return ""
    before = old.wait.text if old is not None and old.wait is not None else ""
    return new.wait.text if new.wait.text != before else ""


def _event(
    process: Process, kind: ProcessEventKind, stamp_ns: int, message: str = "", **more: Any
) -> ProcessEvent:
    return ProcessEvent(
        stamp_ns=stamp_ns,
        kind=kind,
        name=process.name,
        pid=process.pid,
        start_time=process.start_time,
        restarts=more.pop("restarts", process.restarts.total),
        message=message,
        **asdict(more.pop("outcome", process.outcome)),
        **more,
    )


def _node(old: Node | None, new: Node, now: float, stamp_ns: int) -> Iterator[RunEvent]:
    if new.refusals != (0 if old is None else old.refusals):
        yield _refusal(new, stamp_ns)
    text = _new_wait(old, new)
    has_changed = old is None or (old.state, old.attempt, old.reports) != (
        new.state,
        new.attempt,
        new.reports,
    )
    if not has_changed and not text:
        return
    elapsed = now - new.sent_at if new.state in _TIMED and new.attempt else 0.0
    if new.state is NodeState.LOADED and new.took is not None:
        elapsed = new.took  # also when something else is reported later
    yield NodeStateChanged(
        stamp_ns=stamp_ns,
        key=new.key,
        state=new.state,
        elapsed_ns=round(elapsed * 1e9),
        reason=text or new.reason,
        pid=new.pid,
        start_time=new.start_time,
        cpu_time_ns=new.cpu_time_ns,
        unique_id=new.unique_id,
        attempt=new.attempt,
        crashes=new.crashes,
        reloads=new.reloads,
        **asdict(new.outcome),
    )
    if new.is_confirmed and (old is None or old.state is not new.state):
        yield _component(
            new,
            ComponentEventKind.LOADED,
            stamp_ns,
            full_node_name=new.full_node_name,
            pid=new.pid,
            start_time=new.start_time,
            confirmed_by="status",
        )


def _component(node: Node, kind: ComponentEventKind, stamp_ns: int, **more: Any) -> ComponentEvent:
    """Give the event of a load that its container did not report."""
    return ComponentEvent(
        stamp_ns=stamp_ns,
        kind=kind,
        container=node.key.container,
        unique_id=node.unique_id,
        attempt=node.attempt,
        package_name=node.config.package,
        plugin_name=node.config.plugin,
        **more,
    )


def _refusal(node: Node, stamp_ns: int) -> ComponentEvent:
    found = node.finding or ProbeResult()
    return _component(
        node,
        ComponentEventKind.LOAD_FAILED,
        stamp_ns,
        full_node_name=node.key.name,
        error_message=node.reason,
        exit_code=0 if found.signal else found.exit_code,
        signal=found.signal,
        backtrace=found.backtrace,
        modules=found.modules,
        confirmed_by="supervisor" if node.finding is None else "probe",
    )
