"""Events in words and as plain values, as clients and the display of a run get them."""

from __future__ import annotations

import math
from enum import Enum, IntEnum
from typing import Final, NamedTuple

from msgspec.structs import asdict

from play_launch.config.node_key import NodeKey
from play_launch.config.text import duration, listed
from play_launch.process.exit import Exit
from play_launch.recording.console_format import DEBUG, ERROR, INFO, WARN, line_level
from play_launch.supervisor.endpoints import Endpoint
from play_launch.supervisor.events import (
    ActionEvent,
    ActionPhase,
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    ExpectationChanged,
    GraphChanged,
    GroupSample,
    LogRecord,
    MachineChanged,
    MachineState,
    ManagedNodeChanged,
    ManagedState,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    ProcessSample,
    RecordingInterrupted,
    RunEvent,
    SystemSample,
    WantChanged,
    Withdrawn,
)
from play_launch.supervisor.outcome import Cause
from play_launch.supervisor.view import is_guest

OWN_NAME = "play-launch"
_ERRORS = frozenset(
    {
        NodeState.LOAD_FAILED,
        NodeState.CRASHED,
        NodeState.GAVE_UP,
        ContainerState.GAVE_UP,
        ProcessEventKind.GAVE_UP,
        MachineState.FAILED,
    }
)
_WARNINGS = frozenset(
    {
        NodeState.LOST,
        ContainerState.KILLING,
        ContainerState.BACKOFF,
        ProcessEventKind.RESTARTING,
        MachineState.UNREACHABLE,
    }
)
_OVER: Final = frozenset({MachineState.ENDED, MachineState.FAILED})
_NODE: Final = {
    NodeState.LOAD_FAILED: "failed to load",
    NodeState.GAVE_UP: "is not loaded again",
}
_TARGETS_LIMIT: Final = 5
"""Targets of an operation that are named; further ones are counted."""


class EventText(NamedTuple):
    """An event in words."""

    level: int
    """As in ``rcl_interfaces/Log``."""
    source: str
    """Process, container, node or ``play-launch``."""
    text: str


def words_of(event: RunEvent) -> EventText:
    """Word an event; the text may have several lines."""
    match event:
        case NodeStateChanged():
            has_left = event.state is NodeState.UNLOADED and event.reason
            level = WARN if has_left or event.cause is Cause.BLOCKED else INFO
            return EventText(_level(event.state, level), event.container, _node(event))
        case ContainerStateChanged():
            text = because(event.state.value, event.reason)
            return EventText(_level(event.state), event.container, text)
        case ProcessEvent():
            level = WARN if event.exit_code or event.signal else INFO
            return EventText(_level(event.kind, level), event.name, _process(event))
        case ComponentEvent():
            is_bad = event.kind in {ComponentEventKind.LOAD_FAILED, ComponentEventKind.CRASHED}
            text = because(event.kind.name.lower().replace("_", " "), event.error_message)
            source = event.full_node_name or event.plugin_name
            if is_guest(event.unique_id, event.attempt):
                text, source = f"{source}, of another program, {text}", event.container
            lines = [text, *(f"  {frame}" for frame in event.backtrace)]
            return EventText(ERROR if is_bad else INFO, source, "\n".join(lines))
        case OutputLine():
            return EventText(line_level(event), event.process, event.text)
        case LogRecord():
            return EventText(event.level, OWN_NAME, event.message)
        case ActionEvent():
            level = WARN if event.phase is ActionPhase.FAILED else INFO
            return EventText(level, OWN_NAME, _operation(event))
        case ManagedNodeChanged(state=ManagedState.FAILED):
            return EventText(ERROR, event.node, f"autostart failed: {event.reason}")
        case ManagedNodeChanged():
            is_known = event.state not in {ManagedState.ABSENT, ManagedState.ASKED}
            text = f"is {event.state}" if is_known else "lifecycle state unknown"
            return EventText(INFO, event.node, text)
        case MachineChanged():
            state = f"{'has' if event.state in _OVER else 'is'} {event.state}"
            text = because(f"{event.machine} {state}", event.reason)
            return EventText(_level(event.state), OWN_NAME, text)
        case ExpectationChanged(is_met=True):
            return EventText(INFO, event.topic, "is as expected")
        case ExpectationChanged():
            return EventText(WARN, event.topic, f"is not as expected: {event.reason}")
        case GraphChanged():
            changes = [f"+ {name}" for name in event.appeared]
            changes += [f"- {name}" for name in event.vanished]
            for sign, many in (("+", event.endpoints_appeared), ("-", event.endpoints_vanished)):
                changes += [f"{sign} {len(many)} publishers and subscriptions"] if many else []
            return EventText(INFO, "graph", ", ".join(changes))
        case Withdrawn():
            return EventText(INFO, event.key, "taken out of the system")
        case WantChanged():
            text = "requested again" if event.is_wanted else "dismissed by an operator"
            return EventText(DEBUG, event.unit, text)
        case _:
            values = event_object(event)
            kind = values.pop("event")
            shown = [
                f"{name} {value}"
                for name, value in values.items()
                if name != "stamp_ns" and value not in ("", None)
            ]
            return EventText(INFO, OWN_NAME, f"{kind}: {', '.join(shown)}")


def _node(event: NodeStateChanged) -> str:
    if event.state is NodeState.PENDING and event.reason:
        return f"{event.node} {event.reason}"
    if event.cause in {Cause.BLOCKED, Cause.RETURNED}:
        return f"{event.node}: {event.reason}"
    took = duration(event.elapsed_ns) if event.elapsed_ns else ""
    again = " again" if event.reloads else ""
    pid = f", pid {event.pid}" if event.pid else ""
    match event.state:
        case NodeState.LOADED:
            state = f"loaded{again}{f' in {took}' if took else ''}{pid}"
        case NodeState.LOADING if took and event.reason:
            state = f"is still loading after {took}"
        case _:
            state = _NODE.get(event.state, event.state.value)
    return because(f"{event.node} {state}", event.reason)


def _process(event: ProcessEvent) -> str:
    match event.kind:
        case ProcessEventKind.STARTED:
            # Without a pid it is an attached container.
            return f"started, pid {event.pid}" if event.pid else "attaching"
        case ProcessEventKind.EXITED:
            return event.message or str(Exit(code=event.exit_code, signal=event.signal))
        case ProcessEventKind.RESTARTING:
            return event.message or f"restarting, {event.restarts} times so far"
        case ProcessEventKind.GAVE_UP:
            return event.message or "not started again"
        case ProcessEventKind.WAITING:
            return event.message
        case _:
            return because(event.kind.name.lower(), event.message)


def _operation(event: ActionEvent) -> str:
    what = f"{event.action} {listed(event.targets, _TARGETS_LIMIT)}".rstrip()
    match event.phase:
        case ActionPhase.REQUESTED:
            reason = f" ({event.reason})" if event.reason else ""
            command = f": {event.command}" if event.command else ""
            return f"{what}{reason}: requested by user {event.uid}, pid {event.pid}{command}"
        case ActionPhase.FAILED:
            return f"{what} failed: {event.reason}"
        case ActionPhase.DONE:
            return f"{what}: done"


def because(what: str, reason: str) -> str:
    return f"{what}: {reason}" if reason else what


def _level(
    state: NodeState | ContainerState | ProcessEventKind | MachineState, default: int = INFO
) -> int:
    return ERROR if state in _ERRORS else WARN if state in _WARNINGS else default


# As plain values, for JSON.

EVENT_TYPES: Final[dict[type[RunEvent], str]] = {
    ComponentEvent: "component",
    ProcessEvent: "process",
    OutputLine: "output",
    LogRecord: "log",
    NodeStateChanged: "node",
    ContainerStateChanged: "container",
    GraphChanged: "graph",
    Withdrawn: "withdrawn",
    WantChanged: "want",
    ActionEvent: "action",
    ManagedNodeChanged: "managed",
    MachineChanged: "machine",
    ExpectationChanged: "expectation",
    RecordingInterrupted: "recording_interrupted",
    ProcessSample: "process_sample",
    GroupSample: "group_sample",
    SystemSample: "system_sample",
}
"""What `event` says in the object of each."""
_FIELDS: Final = {kind: kind.__struct_fields__ for kind in EVENT_TYPES}


def event_object(event: RunEvent) -> dict[str, object]:
    """Give an event as plain values; ``event`` names its type, the rest are its fields.

    Numbered kinds become their name in small letters (``load_failed``). The key of a node is
    written out, and its parts as ``container`` and ``node``.
    """
    values: dict[str, object] = {"event": EVENT_TYPES[type(event)]}
    for name in _FIELDS[type(event)]:
        value = getattr(event, name)
        values[name] = _plain(value)
        if isinstance(value, NodeKey):
            values |= {"container": value.container, "node": value.name}
    return values


def _plain(value: object) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        return None  # JSON has no such number
    if isinstance(value, tuple):
        return tuple(_plain(one) for one in value)
    if isinstance(value, IntEnum):
        return value.name.lower()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Endpoint):
        return asdict(value)
    return str(value) if isinstance(value, NodeKey) else value


def _names_of_key(key: str) -> tuple[str, ...]:
    if ":/" not in key:
        return (key,)
    node = NodeKey.parsed(key)
    return node.name, node.container


def names_of(event: RunEvent) -> tuple[str, ...]:
    """Give the full names of what an event is about; of a node, that of its container as well."""
    match event:
        case NodeStateChanged():
            return event.node, event.container
        case ContainerStateChanged():
            return (event.container,)
        case ProcessEvent():
            return (event.name,)
        case OutputLine():
            return (event.process,)
        case ComponentEvent():
            return event.full_node_name or event.plugin_name, event.container
        case ActionEvent():
            return tuple(name for key in event.targets for name in _names_of_key(key))
        case Withdrawn():
            return _names_of_key(event.key)
        case WantChanged():
            return _names_of_key(event.unit)
        case ManagedNodeChanged():
            return (event.node,)
        case MachineChanged():
            return (event.machine,)
        case ExpectationChanged():
            return (event.topic,)
        case _:
            return ()
