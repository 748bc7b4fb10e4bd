"""Events as messages: which field of a message holds which field of an event, both ways."""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, Generic, NamedTuple, TypeVar, assert_never

from play_launch.config.node_key import NodeKey
from play_launch.container.cdr.messages import (
    ACTION_EVENT,
    COMPONENT_EVENT,
    GRAPH_EVENT,
    GROUP_STATS,
    PROCESS_STATS,
    STATE_EVENT,
    SYSTEM_STATS,
    log_message,
)
from play_launch.recording import topics
from play_launch.recording.console_format import ERROR, WARN, line_level
from play_launch.supervisor.events import (
    ActionEvent,
    ActionPhase,
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    GraphChanged,
    GroupSample,
    LogRecord,
    ManagedNodeChanged,
    ManagedState,
    MemoryKind,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    ProcessSample,
    RecordingInterrupted,
    RunEvent,
    SubjectKind,
    SystemSample,
    Withdrawn,
    fields_of,
)
from play_launch.supervisor.outcome import Cause, Sequel

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from enum import Enum

    from play_launch.container.cdr.layout import Layout
    from play_launch.recording.topics import Topic

_Event = TypeVar("_Event")


class Column(NamedTuple):
    """One field of an event and the one of the message that holds it."""

    attribute: str
    field: str
    write: Callable[[Any], Any] | None = None
    """None: as it is."""
    read: Callable[[Any], Any] | None = None


class Form(Generic[_Event]):
    """How events of one class stand in messages of one layout."""

    def __init__(
        self,
        event: type[_Event],
        layout: Layout,
        *columns: Column,
        besides: Callable[[_Event], Mapping[str, Any]] = lambda _: {},
    ) -> None:
        """Take the columns but for those that have one name on both sides.

        `besides` gives what a message says as well, but is not needed to read it.
        """
        self.layout = layout
        self._event = event
        alike = set(fields_of(event)) & layout.types.keys()
        alike -= {column.attribute for column in columns}
        self._columns = (*columns, *(Column(name, name) for name in sorted(alike)))
        # Those whose values stay as they are, at once: of samples there are hundreds of thousands.
        plain = [column for column in self._columns if column.write is None]
        assert len(plain) > 1, "of one attribute, what follows would give no tuple"
        self._plain_fields = [column.field for column in plain]
        self._plain_values = attrgetter(*(column.attribute for column in plain))
        self._others = [column for column in self._columns if column.write is not None]
        self._besides = besides

    def write(self, event: _Event) -> bytes:
        """Serialise an event.

        Raises:
            struct.error: When a number does not fit into its field.
        """
        values = dict(self._besides(event))
        values.update(zip(self._plain_fields, self._plain_values(event), strict=True))
        for attribute, field, write, _ in self._others:
            if write is not None:
                values[field] = write(getattr(event, attribute))
        return self.layout.write(values)

    def event(self, fields: Mapping[str, Any], **given: Any) -> _Event:
        """Make the event that a message's fields describe; `given` is what it does not hold.

        Raises:
            ValueError, KeyError: When a field holds what it cannot.
        """
        for attribute, field, _, read in self._columns:
            value = fields[field]
            given[attribute] = read(value) if read else value
        return self._event(**given)


def _word(attribute: str, kind: type[Enum]) -> Column:
    """A state is recorded as its name in small letters."""
    return Column(
        attribute, "state", lambda state: state.name.lower(), lambda word: kind[word.upper()]
    )


_STAMP: Final = Column("stamp_ns", "stamp")
_OUTCOME: Final = (
    Column("cause", "cause", None, Cause),
    Column("sequel", "sequel", None, Sequel),
)


def _names(event: Withdrawn) -> dict[str, str]:
    if event.kind is not SubjectKind.NODE:
        is_container = event.kind is SubjectKind.CONTAINER
        return {"name": event.key, "container": event.key if is_container else ""}
    key = NodeKey.parsed(event.key)
    return {"name": key.name, "container": key.container}


_NODE: Final = Form(
    NodeStateChanged,
    STATE_EVENT,
    _STAMP,
    Column("key", "key", str, NodeKey.parsed),
    _word("state", NodeState),
    Column("reloads", "restarts"),
    *_OUTCOME,
    besides=lambda event: {
        "kind": SubjectKind.NODE,
        "name": event.node,
        "container": event.container,
    },
)
_CONTAINER: Final = Form(
    ContainerStateChanged,
    STATE_EVENT,
    _STAMP,
    Column("container", "key"),
    _word("state", ContainerState),
    *_OUTCOME,
    besides=lambda event: {
        "kind": SubjectKind.CONTAINER,
        "name": event.container,
        "container": event.container,
    },
)
_PROCESS: Final = Form(
    ProcessEvent,
    STATE_EVENT,
    _STAMP,
    Column("name", "key"),
    _word("kind", ProcessEventKind),
    Column("message", "reason"),
    *_OUTCOME,
    besides=lambda event: {"kind": SubjectKind.PROCESS, "name": event.name},
)
COMPONENT: Final = Form(
    ComponentEvent,
    COMPONENT_EVENT,
    _STAMP,
    Column("kind", "event_type", None, ComponentEventKind),
)
WITHDRAWN_STATE: Final = "withdrawn"
WITHDRAWN: Final = Form(
    Withdrawn,
    STATE_EVENT,
    _STAMP,
    Column("kind", "kind", None, SubjectKind),
    besides=lambda event: {"state": WITHDRAWN_STATE, **_names(event)},
)
"""Whatever it was about: the last state of something that was taken out of the running system."""
GRAPH: Final = Form(GraphChanged, GRAPH_EVENT, _STAMP)
ACTION: Final = Form(ActionEvent, ACTION_EVENT, _STAMP, Column("phase", "phase", None, ActionPhase))
PROCESS_SAMPLE: Final = Form(
    ProcessSample,
    PROCESS_STATS,
    _STAMP,
    Column("memory_kind", "memory_kind", None, MemoryKind),
)
GROUP_SAMPLE: Final = Form(GroupSample, GROUP_STATS, _STAMP)
SYSTEM_SAMPLE: Final = Form(
    SystemSample,
    SYSTEM_STATS,
    _STAMP,
)
_MANAGED: Final = Form(
    ManagedNodeChanged,
    STATE_EVENT,
    _STAMP,
    Column("unit", "key"),
    Column("node", "name"),
    _word("state", ManagedState),
    besides=lambda _event: {"kind": SubjectKind.MANAGED},
)
INTERRUPTED_STATE: Final = "interrupted"
_INTERRUPTED: Final = Form(
    RecordingInterrupted,
    STATE_EVENT,
    _STAMP,
    Column("lasted_ns", "elapsed_ns"),
    Column("lost", "culprit"),
    besides=lambda _event: {"kind": SubjectKind.RECORDING, "state": INTERRUPTED_STATE},
)
STATES: Final[dict[SubjectKind, Form[Any]]] = {
    SubjectKind.NODE: _NODE,
    SubjectKind.CONTAINER: _CONTAINER,
    SubjectKind.PROCESS: _PROCESS,
    SubjectKind.MANAGED: _MANAGED,
    SubjectKind.RECORDING: _INTERRUPTED,
}
"""By what they are about; all have the same layout."""

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


class TopicMessage(NamedTuple):
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


def convert(event: RunEvent) -> tuple[TopicMessage, ...]:
    """Return the messages that record ``event``, in the order to be written.

    Raises:
        struct.error: When a number does not fit into its field.
    """
    match event:
        case OutputLine():
            return (TopicMessage(topics.OUTPUT, convert_output(event)[0]),)
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
            everything = TopicMessage(topics.LOG_ALL, data)
            if event.level < WARN:
                return (everything,)
            return (everything, TopicMessage(topics.LOG, data))
        case NodeStateChanged():
            key = f"{SubjectKind.NODE} {event.key}"
            return (TopicMessage(topics.STATES, _NODE.write(event), key),)
        case ContainerStateChanged():
            key = f"{SubjectKind.CONTAINER} {event.container}"
            return (TopicMessage(topics.STATES, _CONTAINER.write(event), key),)
        case ProcessEvent():
            key = f"{SubjectKind.PROCESS} {event.name}"
            return (TopicMessage(topics.STATES, _PROCESS.write(event), key),)
        case ManagedNodeChanged():
            key = f"{SubjectKind.MANAGED} {event.unit}"
            return (TopicMessage(topics.STATES, _MANAGED.write(event), key),)
        case RecordingInterrupted():
            return (TopicMessage(topics.STATES, _INTERRUPTED.write(event)),)
        case Withdrawn():
            data = WITHDRAWN.write(event)
            return (TopicMessage(topics.STATES, data, f"{event.kind} {event.key}"),)
        case ComponentEvent():
            # As its container sent it, if one did.
            data = event.received or COMPONENT.write(event)
            return (TopicMessage(topics.COMPONENT_EVENTS, data),)
        case GraphChanged():
            return (TopicMessage(topics.GRAPH, GRAPH.write(event)),)
        case ActionEvent():
            return (TopicMessage(topics.ACTIONS, ACTION.write(event)),)
        case ProcessSample():
            topic = topics.stats_topic(event.kind, event.key)
            return (TopicMessage(topic, PROCESS_SAMPLE.write(event)),)
        case GroupSample():
            topic = topics.group_topic(event.kind, event.key)
            return (TopicMessage(topic, GROUP_SAMPLE.write(event)),)
        case SystemSample():
            return (TopicMessage(topics.SYSTEM, SYSTEM_SAMPLE.write(event)),)
    assert_never(event)


def convert_output(line: OutputLine) -> tuple[bytes, int]:
    """Return the message for a line of output, and the level that it was written at."""
    level = line_level(line)
    data = log_message(
        line.stamp_ns,
        level,
        line.process,
        line.text + " [cut]" if line.truncated else line.text,
        file=line.stream.value,
        function=f"pid {line.pid}",
    )
    return data, level
