"""From an event of a run to the messages that record it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple, assert_never

from play_launch.cdr.log import log_message
from play_launch.cdr.messages import COMPONENT_EVENT, GRAPH_EVENT, STATE_EVENT
from play_launch.core.events import (
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    GraphChanged,
    LogRecord,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
)
from play_launch.recording import topics
from play_launch.recording.console_format import ERROR, WARN, line_level

if TYPE_CHECKING:
    from play_launch.recording.topics import Topic

_FAILED: Final = frozenset(
    {
        NodeState.LOAD_FAILED,
        NodeState.CRASHED,
        NodeState.GAVE_UP,
        NodeState.LOST,
        ContainerState.GAVE_UP,
    }
)


class Recorded(NamedTuple):
    """One message for the bag."""

    topic: Topic
    data: bytes


def is_failure(event: RunEvent) -> bool:
    """Whether an event reports a failure, so that it must reach the disk at once.

    Output lines are not looked into here: that would cost their producer time.
    """
    match event:
        case ComponentEvent():
            return event.kind in (ComponentEventKind.LOAD_FAILED, ComponentEventKind.CRASHED)
        case ProcessEvent():
            return event.kind is ProcessEventKind.GAVE_UP or (
                event.kind is ProcessEventKind.EXITED
                and (event.exit_code != 0 or event.signal != 0)
            )
        case LogRecord():
            return event.level >= ERROR
        case NodeStateChanged() | ContainerStateChanged():
            return event.state in _FAILED
        case _:
            return False


def convert(event: RunEvent) -> tuple[Recorded, ...]:
    """Return the messages that record ``event``, in the order to be written.

    Raises:
        struct.error: When a number does not fit into its field.
    """
    match event:
        case OutputLine():
            return (convert_output(event)[0],)
        case LogRecord():
            data = log_message(
                event.stamp_ns,
                event.level,
                event.name,
                event.message,
                file=event.file,
                function=event.function,
                line=event.line,
            )
            everything = Recorded(topics.LOG_ALL, data)
            if event.level < WARN:
                return (everything,)
            return (everything, Recorded(topics.LOG, data))
        case NodeStateChanged() | ContainerStateChanged() | ProcessEvent():
            return (Recorded(topics.STATES, STATE_EVENT.write(_state(event))),)
        case ComponentEvent():
            # As its container sent it, if one did.
            data = event.received or _component_event(event)
            return (Recorded(topics.COMPONENT_EVENTS, data),)
        case GraphChanged():
            data = GRAPH_EVENT.write(
                {
                    "stamp": event.stamp_ns,
                    "appeared": event.appeared,
                    "vanished": event.vanished,
                    "nodes": event.nodes,
                }
            )
            return (Recorded(topics.GRAPH, data),)
    assert_never(event)


def convert_output(line: OutputLine) -> tuple[Recorded, int]:
    """Return the message for a line of output, and the level the line was written at."""
    level = line_level(line)
    data = log_message(
        line.stamp_ns,
        level,
        line.process,
        line.text + " [cut]" if line.truncated else line.text,
        file=line.stream.value,
        function=f"pid {line.pid}",
    )
    return Recorded(topics.OUTPUT, data), level


_NODE, _CONTAINER, _PROCESS = range(3)


def _state(event: NodeStateChanged | ContainerStateChanged | ProcessEvent) -> dict[str, Any]:
    """Everything that a change of state says; a state's word is its name in small letters."""
    match event:
        case NodeStateChanged():
            return {
                "stamp": event.stamp_ns,
                "kind": _NODE,
                "key": str(event.key),
                "name": event.node,
                "container": event.container,
                "state": event.state.name.lower(),
                "reason": event.reason,
                "unique_id": event.unique_id,
                "attempt": event.attempt,
                "elapsed_ns": event.elapsed_ns,
                "cpu_time_ns": event.cpu_time_ns,
                "pid": event.pid,
                "crashes": event.crashes,
                "restarts": event.reloads,
            }
        case ContainerStateChanged():
            return {
                "stamp": event.stamp_ns,
                "kind": _CONTAINER,
                "key": event.container,
                "name": event.container,
                "container": event.container,
                "state": event.state.name.lower(),
                "reason": event.reason,
                "mechanism": event.mechanism,
            }
        case ProcessEvent():
            return {
                "stamp": event.stamp_ns,
                "kind": _PROCESS,
                "key": event.name,
                "name": event.name,
                "state": event.kind.name.lower(),
                "reason": event.message,
                "start_time": event.start_time,
                "pid": event.pid,
                "exit_code": event.exit_code,
                "signal": event.signal,
                "restarts": event.restarts,
                "command": event.command,
            }


def _component_event(event: ComponentEvent) -> bytes:
    return COMPONENT_EVENT.write(
        {
            **{name: getattr(event, name) for name in _COMPONENT_FIELDS},
            "stamp": event.stamp_ns,
            "event_type": event.kind,
        }
    )


_COMPONENT_FIELDS: Final = COMPONENT_EVENT.types.keys() - {"stamp", "event_type"}
