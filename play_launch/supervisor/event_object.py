"""Events as plain values, for JSON: what programs get that watch a run or read a recording."""

from __future__ import annotations

import math
from enum import Enum, IntEnum
from typing import Final

from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import (
    ActionEvent,
    ComponentEvent,
    ContainerStateChanged,
    GraphChanged,
    GroupSample,
    LogRecord,
    ManagedNodeChanged,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessSample,
    RecordingInterrupted,
    RunEvent,
    SystemSample,
    Withdrawn,
)

EVENT_TYPES: Final[dict[type[RunEvent], str]] = {
    ComponentEvent: "component",
    ProcessEvent: "process",
    OutputLine: "output",
    LogRecord: "log",
    NodeStateChanged: "node",
    ContainerStateChanged: "container",
    GraphChanged: "graph",
    Withdrawn: "withdrawn",
    ActionEvent: "action",
    ManagedNodeChanged: "managed",
    RecordingInterrupted: "recording_interrupted",
    ProcessSample: "process_sample",
    GroupSample: "group_sample",
    SystemSample: "system_sample",
}
"""What `event` says in the object of each."""
_FIELDS: Final = {
    kind: tuple(name for name in kind.__annotations__ if name != "received") for kind in EVENT_TYPES
}
"""Of what was received, the other fields are made."""


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
    return str(value) if isinstance(value, NodeKey) else value


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
            return (event.full_node_name,)
        case ActionEvent():
            return event.targets
        case ManagedNodeChanged():
            return (event.node,)
        case _:
            return ()
