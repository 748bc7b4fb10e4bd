"""Events as JSON, one object a line, for programs that watch a run."""

from __future__ import annotations

import json
from enum import Enum, IntEnum
from typing import IO, TYPE_CHECKING, Final

from play_launch.core.events import (
    ComponentEvent,
    ContainerStateChanged,
    GraphChanged,
    LogRecord,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    RunEvent,
)
from play_launch.core.node_key import NodeKey

if TYPE_CHECKING:
    from collections.abc import Sequence

    from play_launch.cli.show.display import Shown

_TYPES: Final[dict[type[RunEvent], str]] = {
    ComponentEvent: "component",
    ProcessEvent: "process",
    OutputLine: "output",
    LogRecord: "log",
    NodeStateChanged: "node",
    ContainerStateChanged: "container",
    GraphChanged: "graph",
}
_FIELDS: Final = {
    kind: tuple(name for name in kind.__annotations__ if name != "received") for kind in _TYPES
}
"""Of what was received, the other fields are made."""


def event_object(event: RunEvent) -> dict[str, object]:
    """Give an event as plain values; ``event`` names its type, the rest are its fields.

    Numbered kinds become their name in small letters (``load_failed``). The key of a node is
    written out, and its parts as ``container`` and ``node``.
    """
    values: dict[str, object] = {"event": _TYPES[type(event)]}
    for name in _FIELDS[type(event)]:
        value = getattr(event, name)
        values[name] = _plain(value)
        if isinstance(value, NodeKey):
            values |= {"container": value.container, "node": value.name}
    return values


def _plain(value: object) -> object:
    if isinstance(value, IntEnum):
        return value.name.lower()
    if isinstance(value, Enum):
        return value.value
    return str(value) if isinstance(value, NodeKey) else value


class JsonStyle:
    """Writes events to a stream as they come."""

    def __init__(self, stream: IO[str], *, quiet: bool) -> None:
        """``quiet`` leaves the output of nodes away."""
        self._stream = stream
        self._quiet = quiet

    def wants(self, event: RunEvent) -> bool:
        """Everything, but output when it is not wanted."""
        return not (self._quiet and isinstance(event, OutputLine))

    def show(self, batch: Sequence[Shown], missed: int) -> float | None:
        """Write one object for each event."""
        objects = [event_object(shown.event) for shown in batch]
        if missed:
            objects.append({"event": "missed", "lines": missed})
        if objects:
            self._stream.write("".join(f"{encode(values)}\n" for values in objects))
            self._stream.flush()
        return None

    def close(self) -> None:
        """Nothing to restore."""


def encode(values: dict[str, object]) -> str:
    """Write one object on one line; plain ASCII, so that no stream's encoding can refuse it."""
    return json.dumps(values, separators=(",", ":"))
