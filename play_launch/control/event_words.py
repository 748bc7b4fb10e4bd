"""Events in words: level, source and text, as clients show them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from play_launch.recording.console_format import ERROR, INFO, WARN, line_level
from play_launch.supervisor.event_object import event_object
from play_launch.supervisor.events import (
    ActionEvent,
    ActionPhase,
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    GraphChanged,
    LogRecord,
    ManagedNodeChanged,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    Withdrawn,
)
from play_launch.supervisor.goal_life import ManagedState

if TYPE_CHECKING:
    from play_launch.supervisor.events import RunEvent

OWN_NAME = "play-launch"
_ERRORS = frozenset(
    {
        NodeState.LOAD_FAILED,
        NodeState.CRASHED,
        NodeState.GAVE_UP,
        ContainerState.GAVE_UP,
        ManagedState.FAILED,
    }
)
_WARNINGS = frozenset({NodeState.LOST, ContainerState.KILLING, ContainerState.BACKOFF})


class Words(NamedTuple):
    """An event in words."""

    level: int
    """As in ``rcl_interfaces/Log``."""
    source: str
    """Process, container, node or ``play-launch``."""
    text: str


def words_of(event: RunEvent) -> Words:
    """Word an event; the text may have several lines."""
    match event:
        case NodeStateChanged():
            text = _because(f"{event.node} {event.state}", event.reason)
            return Words(_level(event.state), event.container, text)
        case ContainerStateChanged():
            text = _because(event.state.value, event.reason)
            return Words(_level(event.state), event.container, text)
        case ProcessEvent():
            reason = event.message or (f"pid {event.pid}" if event.pid else "")
            text = _because(event.kind.name.lower().replace("_", " "), reason)
            return Words(_level_of_process(event), event.name, text)
        case ComponentEvent():
            is_bad = event.kind in {ComponentEventKind.LOAD_FAILED, ComponentEventKind.CRASHED}
            text = _because(event.kind.name.lower().replace("_", " "), event.error_message)
            lines = [text, *(f"  {frame}" for frame in event.backtrace)]
            source = event.full_node_name or event.plugin_name
            return Words(ERROR if is_bad else INFO, source, "\n".join(lines))
        case OutputLine():
            return Words(line_level(event), event.process, event.text)
        case LogRecord():
            return Words(event.level, OWN_NAME, event.message)
        case ActionEvent():
            what = f"{event.action} {', '.join(event.targets)}".rstrip()
            text = _because(f"{what} {event.phase.name.lower()}", event.reason)
            if event.phase is ActionPhase.REQUESTED:
                text = f"{text} (user {event.uid}, pid {event.pid}: {event.command})"
            return Words(WARN if event.phase is ActionPhase.FAILED else INFO, OWN_NAME, text)
        case ManagedNodeChanged(state=ManagedState.FAILED):
            return Words(ERROR, event.node, f"autostart failed: {event.reason}")
        case ManagedNodeChanged():
            is_known = event.state not in {ManagedState.ABSENT, ManagedState.ASKED}
            text = f"is {event.state}" if is_known else "lifecycle state unknown"
            return Words(INFO, event.node, text)
        case GraphChanged():
            changes = [f"+ {name}" for name in event.appeared]
            changes += [f"- {name}" for name in event.vanished]
            return Words(INFO, "graph", ", ".join(changes))
        case Withdrawn():
            return Words(INFO, event.key, _because("taken out of the system", event.reason))
        case _:
            values = event_object(event)
            kind = values.pop("event")
            shown = [
                f"{name} {value}"
                for name, value in values.items()
                if name != "stamp_ns" and value not in ("", None)
            ]
            return Words(INFO, OWN_NAME, f"{kind}: {', '.join(shown)}")


def _because(what: str, reason: str) -> str:
    return f"{what}: {reason}" if reason else what


def _level(state: NodeState | ContainerState) -> int:
    return ERROR if state in _ERRORS else WARN if state in _WARNINGS else INFO


def _level_of_process(event: ProcessEvent) -> int:
    match event.kind:
        case ProcessEventKind.GAVE_UP:
            return ERROR
        case ProcessEventKind.RESTARTING:
            return WARN
        case ProcessEventKind.EXITED if event.exit_code or event.signal:
            return WARN
        case _:
            return INFO
