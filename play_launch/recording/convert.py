"""From an event of a run to the messages that record it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple, assert_never

from play_launch.container.cdr.messages import log_message
from play_launch.recording import forms, topics
from play_launch.recording.console_format import ERROR, WARN, line_level
from play_launch.supervisor.events import (
    ActionEvent,
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    GraphChanged,
    GroupSample,
    LogRecord,
    ManagedNodeChanged,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    ProcessSample,
    RecordingInterrupted,
    RunEvent,
    StateEvent,
    SubjectKind,
    SystemSample,
    Withdrawn,
)
from play_launch.supervisor.goal_life import ManagedState

if TYPE_CHECKING:
    from play_launch.recording.topics import Topic

_FAILED: Final = frozenset(
    {
        NodeState.LOAD_FAILED,
        NodeState.CRASHED,
        NodeState.GAVE_UP,
        NodeState.LOST,
        ContainerState.GAVE_UP,
        ManagedState.FAILED,
    }
)


class Recorded(NamedTuple):
    """One message for the bag."""

    topic: Topic
    data: bytes
    key: str = ""
    """Of a message that holds until the next one with this key."""


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
        case NodeStateChanged() | ContainerStateChanged() | ManagedNodeChanged():
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
        case NodeStateChanged():
            return (_state(SubjectKind.NODE, str(event.key), event),)
        case ContainerStateChanged():
            return (_state(SubjectKind.CONTAINER, event.container, event),)
        case ProcessEvent():
            return (_state(SubjectKind.PROCESS, event.name, event),)
        case ManagedNodeChanged():
            return (_state(SubjectKind.MANAGED, event.unit, event),)
        case RecordingInterrupted():
            data = forms.STATES[SubjectKind.RECORDING].write(event)
            return (Recorded(topics.STATES, data),)
        case Withdrawn():
            data = forms.WITHDRAWN.write(event)
            return (Recorded(topics.STATES, data, f"{event.kind} {event.key}"),)
        case ComponentEvent():
            # As its container sent it, if one did.
            data = event.received or forms.COMPONENT.write(event)
            return (Recorded(topics.COMPONENT_EVENTS, data),)
        case GraphChanged():
            return (Recorded(topics.GRAPH, forms.GRAPH.write(event)),)
        case ActionEvent():
            return (Recorded(topics.ACTIONS, forms.ACTION.write(event)),)
        case ProcessSample():
            topic = topics.stats_topic(event.kind, event.key)
            return (Recorded(topic, forms.PROCESS_SAMPLE.write(event)),)
        case GroupSample():
            topic = topics.group_topic(event.kind, event.key)
            return (Recorded(topic, forms.GROUP_SAMPLE.write(event)),)
        case SystemSample():
            return (Recorded(topics.SYSTEM, forms.SYSTEM_SAMPLE.write(event)),)
    assert_never(event)


def _state(
    kind: SubjectKind,
    key: str,
    event: StateEvent | ManagedNodeChanged,
) -> Recorded:
    return Recorded(topics.STATES, forms.STATES[kind].write(event), f"{kind} {key}")


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
