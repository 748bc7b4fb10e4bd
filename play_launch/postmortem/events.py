"""From the messages of a recording back to the events of its run."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, Final

from play_launch.config.node_key import NodeKey
from play_launch.container.cdr.messages import (
    ACTION_EVENT,
    COMPONENT_EVENT,
    GRAPH_EVENT,
    GROUP_STATS,
    LOG,
    PROCESS_STATS,
    STATE_EVENT,
    SYSTEM_STATS,
)
from play_launch.container.cdr.structure import CdrError
from play_launch.recording import forms, topics
from play_launch.supervisor.events import LogRecord, OutputLine, RunEvent, Stream, SubjectKind

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.container.cdr.structure import Layout
    from play_launch.postmortem.bag_reader import Message

_CUT: Final = " [cut]"
_NO_MODULES: Final = bytes(11)
"""The lengths of the modules and of the container, with what aligns them."""
_NO_OUTCOME: Final = bytes(32)
"""Cause, sequel, delay and culprit, with what aligns them."""


_NO_ENDPOINTS: Final = bytes(11)
"""The lengths of two sequences, with what aligns them."""


class UnreadableEventError(Exception):
    """A message does not hold what its topic promises."""


def event_of(message: Message) -> RunEvent | None:
    """Read an event; None for a topic that holds none, or repeats another one.

    A topic of another type, as earlier versions wrote the graph, counts as one that holds none.

    Raises:
        UnreadableEventError: When the message is not what it should be.
    """
    topic = message.topic
    read = _READERS.get((topic.name, topic.type_name))
    if read is None and topic.kind:
        read = _SAMPLES.get(topic.type_name)
    if read is None:
        return None
    try:
        return read(message)
    except (CdrError, ValueError, KeyError) as error:
        reason = f"a message of {message.topic.name} cannot be read: {error}"
        raise UnreadableEventError(reason) from error


def _fields(layout: Layout, message: Message, more: bytes = b"") -> dict[str, Any]:
    fields = layout.read(message.data + more)
    if message.ahead_ns is None:
        fields["stamp"] = message.log_time
        return fields
    # The stamp may be from before the clock was set.
    late = fields["stamp"] - message.log_time
    if abs(late - message.ahead_ns) < abs(late):
        fields["stamp"] -= message.ahead_ns
    return fields


def _state(message: Message) -> RunEvent:
    # Earlier versions wrote no causes: this reads as `Cause.NOT_RECORDED`.
    fields = _fields(STATE_EVENT, message, _NO_OUTCOME)
    if fields["state"] == forms.WITHDRAWN_STATE:
        return forms.WITHDRAWN.event(fields)
    event: RunEvent = forms.STATES[SubjectKind(fields["kind"])].event(fields)
    return event


def _component(message: Message) -> RunEvent:
    # Earlier versions wrote no modules, and no container.
    return forms.COMPONENT.event(_fields(COMPONENT_EVENT, message, _NO_MODULES))


def _graph(message: Message) -> RunEvent:
    # Earlier versions wrote no endpoints: this reads as none.
    return forms.GRAPH.event(_fields(GRAPH_EVENT, message, _NO_ENDPOINTS))


def _action(message: Message) -> RunEvent:
    return forms.ACTION.event(_fields(ACTION_EVENT, message))


def _process_sample(message: Message) -> RunEvent:
    kind, key = message.topic.kind, message.topic.key
    return forms.PROCESS_SAMPLE.event(
        _fields(PROCESS_STATS, message), kind=_subject_kind(kind, key), key=key
    )


def _group_sample(message: Message) -> RunEvent:
    kind, key = message.topic.kind, message.topic.key
    return forms.GROUP_SAMPLE.event(
        _fields(GROUP_STATS, message), kind=_subject_kind(kind, key), key=key
    )


@cache  # a long recording has hundreds of thousands of samples
def _subject_kind(word: str, key: str) -> SubjectKind:
    kind = SubjectKind[word.upper()]
    if kind is SubjectKind.NODE:
        NodeKey.parsed(key)  # readers rely on that
    return kind


def _system_sample(message: Message) -> RunEvent:
    return forms.SYSTEM_SAMPLE.event(_fields(SYSTEM_STATS, message))


def _output(message: Message) -> RunEvent:
    fields = _fields(LOG, message)
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


def _log(message: Message) -> RunEvent:
    fields = _fields(LOG, message)
    return LogRecord(
        stamp_ns=fields["stamp"],
        level=fields["level"],
        name=fields["name"],
        message=fields["msg"],
        file=fields["file"],
        function=fields["function"],
        line=fields["line"],
    )


_READERS: Final[dict[tuple[str, str], Callable[[Message], RunEvent]]] = {
    (topic.name, topic.type_name): read
    for topic, read in (
        (topics.STATES, _state),
        (topics.COMPONENT_EVENTS, _component),
        (topics.GRAPH, _graph),
        (topics.ACTIONS, _action),
        (topics.OUTPUT, _output),
        (topics.LOG_ALL, _log),
        (topics.SYSTEM, _system_sample),
    )
}
_SAMPLES: Final[dict[str, Callable[[Message], RunEvent]]] = {
    topics.PROCESS_STATS: _process_sample,
    topics.GROUP_STATS: _group_sample,
}
"""By the type alone: each thing has a topic of its own."""
