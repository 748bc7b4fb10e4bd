"""From the messages of a recording back to the events of its run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from play_launch.cdr.layout import CdrError
from play_launch.cdr.messages import COMPONENT_EVENT, GRAPH_EVENT, LOG, STATE_EVENT
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
    Stream,
)
from play_launch.core.node_key import NodeKey
from play_launch.recording import topics

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.history.bag_reader import Message

_CUT: Final = " [cut]"


class UnreadableEventError(Exception):
    """A message does not hold what its topic promises."""


def event_of(message: Message) -> RunEvent | None:
    """Read an event; None for a topic that holds none, or repeats another one.

    A topic of another type, as earlier versions wrote the graph, counts as one that holds none.

    Raises:
        UnreadableEventError: When the message is not what it should be.
    """
    read = _READERS.get(message.topic[:2])
    if read is None:
        return None
    try:
        return read(message.data)
    except (CdrError, ValueError, KeyError) as error:
        reason = f"a message of {message.topic.name} cannot be read: {error}"
        raise UnreadableEventError(reason) from error


def _state(data: bytes) -> RunEvent:
    fields = STATE_EVENT.read(data)
    word = fields["state"].upper()
    match fields["kind"]:
        case 0:
            return NodeStateChanged(
                stamp_ns=fields["stamp"],
                key=NodeKey(fields["container"], fields["name"]),
                state=NodeState[word],
                elapsed_ns=fields["elapsed_ns"],
                reason=fields["reason"],
                pid=fields["pid"],
                cpu_time_ns=fields["cpu_time_ns"],
                unique_id=fields["unique_id"],
                attempt=fields["attempt"],
                crashes=fields["crashes"],
                reloads=fields["restarts"],
            )
        case 1:
            return ContainerStateChanged(
                stamp_ns=fields["stamp"],
                container=fields["key"],
                state=ContainerState[word],
                reason=fields["reason"],
                mechanism=fields["mechanism"],
            )
        case 2:
            return ProcessEvent(
                stamp_ns=fields["stamp"],
                kind=ProcessEventKind[word],
                name=fields["key"],
                pid=fields["pid"],
                start_time=fields["start_time"],
                exit_code=fields["exit_code"],
                signal=fields["signal"],
                restarts=fields["restarts"],
                message=fields["reason"],
                command=fields["command"],
            )
        case kind:
            raise ValueError(f"there is no kind {kind}")


def _component(data: bytes) -> RunEvent:
    fields: dict[str, Any] = COMPONENT_EVENT.read(data)
    return ComponentEvent(
        stamp_ns=fields.pop("stamp"),
        kind=ComponentEventKind(fields.pop("event_type")),
        container="",  # the message does not say: its container sent it
        received=data,
        **fields,
    )


def _graph(data: bytes) -> RunEvent:
    fields = GRAPH_EVENT.read(data)
    return GraphChanged(
        stamp_ns=fields["stamp"],
        appeared=fields["appeared"],
        vanished=fields["vanished"],
        nodes=fields["nodes"],
    )


def _output(data: bytes) -> RunEvent:
    fields = LOG.read(data)
    text = fields["msg"]
    pid = fields["function"].removeprefix("pid ")
    return OutputLine(
        stamp_ns=fields["stamp"],
        process=fields["name"],
        pid=int(pid) if pid.isdecimal() else 0,
        stream=Stream(fields["file"]),
        text=text.removesuffix(_CUT),
        truncated=text.endswith(_CUT),
    )


def _log(data: bytes) -> RunEvent:
    fields = LOG.read(data)
    return LogRecord(
        stamp_ns=fields["stamp"],
        level=fields["level"],
        name=fields["name"],
        message=fields["msg"],
        file=fields["file"],
        function=fields["function"],
        line=fields["line"],
    )


_READERS: Final[dict[tuple[str, str], Callable[[bytes], RunEvent]]] = {
    (topic.name, topic.type_name): read
    for topic, read in (
        (topics.STATES, _state),
        (topics.COMPONENT_EVENTS, _component),
        (topics.GRAPH, _graph),
        (topics.OUTPUT, _output),
        (topics.LOG_ALL, _log),
    )
}
