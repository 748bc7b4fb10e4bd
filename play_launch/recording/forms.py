"""Events as messages: which field of a message holds which field of an event, both ways."""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, Generic, NamedTuple, TypeVar

from msgspec import Struct
from msgspec.structs import asdict

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
from play_launch.container.messages import state_of_guest
from play_launch.recording import topics
from play_launch.recording.console_format import ERROR, WARN, line_level
from play_launch.recording.topics import Topic
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
    WantChanged,
    Withdrawn,
)
from play_launch.supervisor.outcome import Cause, Sequel
from play_launch.supervisor.view import is_guest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from enum import Enum

    from play_launch.container.cdr.structure import Layout

_Event = TypeVar("_Event", bound=Struct)


class Column(NamedTuple):
    """One field of an event and the one of the message that holds it."""

    attribute: str
    field: str
    write: Callable[[Any], Any] | None = None
    """None: as it is."""
    read: Callable[[Any], Any] | None = None


class TopicMessage(NamedTuple):
    """One message for the bag."""

    topic: Topic
    data: bytes
    key: str = ""
    """Of a message that holds until the next one with this key."""


class Form(Generic[_Event]):
    """How events of one class stand in messages of a topic."""

    def __init__(
        self,
        event: type[_Event],
        topic: Topic | Callable[[Any], Topic],
        layout: Layout,
        *columns: Column,
        besides: Callable[[_Event], Mapping[str, Any]] = lambda _: {},
    ) -> None:
        """Take the columns but for those that have one name on both sides.

        `besides` gives what a message says as well, but is not needed to read it.
        """
        self.type = event
        self._topic = topic
        self._layout = layout
        columns = (Column("stamp_ns", "stamp"), *columns)
        alike = set(event.__struct_fields__) & layout.types.keys()
        alike -= {column.attribute for column in columns}
        self._columns = (*columns, *(Column(name, name) for name in sorted(alike)))
        # Those whose values stay as they are, at once: of samples there are hundreds of thousands.
        plain = [column for column in self._columns if column.write is None]
        assert len(plain) > 1, "of one attribute, what follows would give no tuple"
        self._plain_fields = [column.field for column in plain]
        self._plain_values = attrgetter(*(column.attribute for column in plain))
        self._others = [
            (column.attribute, column.field, column.write) for column in columns if column.write
        ]
        self._besides = besides

    def message(self, event: _Event) -> TopicMessage:
        """Make the message that records an event.

        Raises:
            struct.error: When a number does not fit into its field.
        """
        values = dict(self._besides(event))
        values.update(zip(self._plain_fields, self._plain_values(event), strict=True))
        for attribute, field, write in self._others:
            values[field] = write(getattr(event, attribute))
        # A state holds until the next one of the same thing.
        is_state = self._layout is STATE_EVENT and "key" in values
        key = f"{values['kind']} {values['key']}" if is_state else ""
        topic = self._topic if isinstance(self._topic, Topic) else self._topic(event)
        return TopicMessage(topic, self._layout.write(values), key)

    def event(self, fields: Mapping[str, Any], **given: Any) -> _Event:
        """Make the event that a message's fields describe; `given` is what it does not hold.

        Raises:
            ValueError, KeyError: When a field holds what it cannot.
        """
        for attribute, field, _, read in self._columns:
            value = fields[field]
            given[attribute] = read(value) if read else value
        return self.type(**given)


def _word(attribute: str, kind: type[Enum]) -> Column:
    """A state is recorded as its name in small letters."""
    words = {state: state.name.lower() for state in kind}
    return Column(attribute, "state", words.__getitem__, lambda word: kind[word.upper()])


def _is(yes: str, no: str) -> Callable[[bool], str]:
    return lambda is_so: yes if is_so else no


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


def _endpoints(every: Iterable[Mapping[str, Any]]) -> tuple[Endpoint, ...]:
    return tuple(Endpoint(**fields) for fields in every)


_NODE: Final = Form(
    NodeStateChanged,
    topics.STATES,
    STATE_EVENT,
    Column("key", "key", str, NodeKey.parsed),
    _word("state", NodeState),
    Column("reloads", "restarts"),
    *_OUTCOME,
    besides=lambda event: {
        "kind": SubjectKind.NODE,
        "name": event.key.name,
        "container": event.key.container,
    },
)
_CONTAINER: Final = Form(
    ContainerStateChanged,
    topics.STATES,
    STATE_EVENT,
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
    topics.STATES,
    STATE_EVENT,
    Column("name", "key"),
    _word("kind", ProcessEventKind),
    Column("message", "reason"),
    *_OUTCOME,
    besides=lambda event: {"kind": SubjectKind.PROCESS, "name": event.name},
)
COMPONENT: Final = Form(
    ComponentEvent,
    topics.COMPONENT_EVENTS,
    COMPONENT_EVENT,
    Column("kind", "event_type", None, ComponentEventKind),
)
WITHDRAWN_STATE: Final = "withdrawn"
WITHDRAWN: Final = Form(
    Withdrawn,
    topics.STATES,
    STATE_EVENT,
    Column("kind", "kind", None, SubjectKind),
    besides=lambda event: {"state": WITHDRAWN_STATE, **_names(event)},
)
"""Whatever it was about: the last state of something that was taken out of the running system."""
GRAPH: Final = Form(
    GraphChanged,
    topics.GRAPH,
    GRAPH_EVENT,
    *(
        Column(name, name, lambda every: tuple(map(asdict, every)), _endpoints)
        for name in ("endpoints_appeared", "endpoints_vanished")
    ),
)
ACTION: Final = Form(
    ActionEvent, topics.ACTIONS, ACTION_EVENT, Column("phase", "phase", None, ActionPhase)
)
PROCESS_SAMPLE: Final = Form(
    ProcessSample,
    lambda sample: topics.stats_topic(sample.kind, sample.key),
    PROCESS_STATS,
    Column("memory_kind", "memory_kind", None, MemoryKind),
)
GROUP_SAMPLE: Final = Form(
    GroupSample, lambda sample: topics.group_topic(sample.kind, sample.key), GROUP_STATS
)
SYSTEM_SAMPLE: Final = Form(SystemSample, topics.SYSTEM, SYSTEM_STATS)
_MANAGED: Final = Form(
    ManagedNodeChanged,
    topics.STATES,
    STATE_EVENT,
    Column("unit", "key"),
    Column("node", "name"),
    _word("state", ManagedState),
    besides=lambda _event: {"kind": SubjectKind.MANAGED},
)
_MACHINE: Final = Form(
    MachineChanged,
    topics.STATES,
    STATE_EVENT,
    Column("machine", "key"),
    _word("state", MachineState),
    besides=lambda event: {"kind": SubjectKind.MACHINE, "name": event.machine},
)
_EXPECTATION: Final = Form(
    ExpectationChanged,
    topics.STATES,
    STATE_EVENT,
    Column("topic", "key"),
    Column("is_met", "state", _is("met", "broken"), "met".__eq__),
    besides=lambda event: {"kind": SubjectKind.EXPECTATION, "name": event.topic},
)
_WANT: Final = Form(
    WantChanged,
    topics.STATES,
    STATE_EVENT,
    Column("unit", "key"),
    Column("is_wanted", "state", _is("wanted", "dismissed"), "wanted".__eq__),
    besides=lambda event: {"kind": SubjectKind.WANT, "name": event.unit.rpartition(":")[2]},
)
INTERRUPTED_STATE: Final = "interrupted"
_INTERRUPTED: Final = Form(
    RecordingInterrupted,
    topics.STATES,
    STATE_EVENT,
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
    SubjectKind.MACHINE: _MACHINE,
    SubjectKind.EXPECTATION: _EXPECTATION,
    SubjectKind.WANT: _WANT,
}
"""By what they are about; all have the same layout."""
_FORMS: Final[dict[type, Form[Any]]] = {
    form.type: form
    for form in (
        *STATES.values(),
        COMPONENT,
        WITHDRAWN,
        GRAPH,
        ACTION,
        PROCESS_SAMPLE,
        GROUP_SAMPLE,
        SYSTEM_SAMPLE,
    )
}

_FAILED: Final = frozenset(
    {
        NodeState.LOAD_FAILED,
        NodeState.CRASHED,
        NodeState.GAVE_UP,
        NodeState.LOST,
        ContainerState.GAVE_UP,
        ManagedState.FAILED,
        MachineState.UNREACHABLE,
        MachineState.FAILED,
    }
)


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
        case NodeStateChanged() | ContainerStateChanged() | ManagedNodeChanged() | MachineChanged():
            return event.state in _FAILED
        case ExpectationChanged():
            return not event.is_met
        case _:
            return False


def convert(event: RunEvent) -> tuple[TopicMessage, ...]:
    """Return the messages that record ``event``, in the order to be written.

    Raises:
        struct.error: When a number does not fit into its field.
    """
    match event:
        case OutputLine():
            return (output_message(event, line_level(event)),)
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
        case ComponentEvent() if is_guest(event.unique_id, event.attempt):
            return COMPONENT.message(event), _NODE.message(state_of_guest(event))
    return (_FORMS[type(event)].message(event),)


def output_message(line: OutputLine, level: int) -> TopicMessage:
    """Return the message for a line of output of a level."""
    data = log_message(
        line.stamp_ns,
        level,
        line.process,
        line.text + " [cut]" if line.truncated else line.text,
        file=line.stream.value,
        function=f"pid {line.pid}",
    )
    return TopicMessage(topics.OUTPUT, data)
