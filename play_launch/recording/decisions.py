"""What the supervisor decided upon: its inputs in the recording, for a reducer to decide again.

A message holds the inputs of a moment in MessagePack. It is a `ParameterValue` with a byte array:
rosbag2 refused files that mix CDR with other encodings until 2026.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import msgspec
from msgspec.structs import replace

from play_launch.config.model import ParameterType, ReplayConfig
from play_launch.container.cdr.messages import PARAMETER_VALUE
from play_launch.container.cdr.structure import text_bytes
from play_launch.recording.resolved_form import without
from play_launch.supervisor.events import (
    ContainerStateChanged,
    ManagedNodeChanged,
    NodeStateChanged,
    ProcessEvent,
    WantChanged,
    Withdrawn,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from play_launch.supervisor.events import RunEvent
    from play_launch.supervisor.inputs import Input, Origin, Over

STATES: Final = (
    NodeStateChanged,
    ContainerStateChanged,
    ProcessEvent,
    ManagedNodeChanged,
    WantChanged,
    Withdrawn,
)
"""Events that inputs lead to."""
_LEFT_OUT: Final = frozenset(
    {
        "arguments",
        "cgroups",
        "command",
        "cwd",
        "environment",
        "extra_arguments",
        "file",
        "included_files",
        "line",
        "log_dir",
        "parameter_files",
        "parameters",
        "prefix",
        "process_parameters",
        "record",
        "remappings",
        "resources",
        "ros_arguments",
        "taken",
    }
)
"""Fields of a configuration that no decision depends on; it stands in the recording as a whole."""
_VALUES: Final = frozenset({"before", "after"})
"""Of a change in a plan: what is done about it stands beside them."""
_TAG: Final = "type"


class UnreadableInputError(Exception):
    """A message does not hold inputs that this version knows."""


class Decision(NamedTuple):
    """One input, when it was processed, and the random number that it was given."""

    number: int
    """From 0 on, without a gap."""
    now: float
    """Seconds of the event loop's clock."""
    chance: float
    events: int
    """Events about states that were published before."""
    said: Origin | Input | Over
    secrets: frozenset[str] = frozenset()


class DecisionLog:
    """Numbers the inputs of a run; belongs to the thread of the event loop."""

    def __init__(self, take: Callable[[Decision], object]) -> None:
        self._take = take
        self._count = 0
        self._events = 0
        self.secrets: frozenset[str] = frozenset()
        """What stays out of the recording."""

    def note(self, event: RunEvent) -> None:
        self._events += isinstance(event, STATES)

    def add(self, now: float, said: Origin | Input | Over, chance: float = 0.0) -> None:
        """Hand an input over; it is written by another thread."""
        self._take(Decision(self._count, now, chance, self._events, said, self.secrets))
        self._count += 1


def written(decisions: Sequence[Decision]) -> bytes:
    """Write a message.

    Raises:
        TypeError, OverflowError: When an input cannot be written.
    """
    rows = [
        (each.number, each.now, each.chance, each.events, _plain(each.said, each.secrets))
        for each in decisions
    ]
    data = msgspec.msgpack.encode(rows)
    return PARAMETER_VALUE.write({"type": ParameterType.BYTE_ARRAY, "byte_array_value": data})


def read(message: bytes) -> list[Decision]:
    """Read what `written` wrote, be it of another version.

    Raises:
        UnreadableInputError: When it is something else.
    """
    from play_launch.supervisor import inputs  # noqa: PLC0415 - the recorder does not need it

    kind = tuple[int, float, float, int, inputs.Origin | inputs.Input | inputs.Over]
    try:
        data = PARAMETER_VALUE.read(message)["byte_array_value"]
        rows: list[Any] = msgspec.msgpack.decode(data, type=list[kind], dec_hook=_typed)
    except (ValueError, msgspec.MsgspecError, RecursionError) as error:
        raise UnreadableInputError(str(error)) from error
    return [Decision(*row) for row in rows]


def _plain(said: Any, secrets: Collection[str]) -> Any:
    for name in ("config", "target"):
        if isinstance(config := getattr(said, name, None), ReplayConfig):
            said = replace(said, **{name: _bare(config)})
    values = msgspec.to_builtins(said, builtin_types=(bytes,), enc_hook=_untyped)
    return _reduced(values, secrets)


def _bare(config: ReplayConfig) -> ReplayConfig:
    """Leave out the bulk of a configuration, which would be converted in one go for the others."""
    nothing: dict[str, Any] = {"environment": {}, "process_parameters": ()}
    containers = [
        replace(
            box,
            **nothing,
            composable_nodes=tuple(
                replace(node, parameters=(), extra_arguments=()) for node in box.composable_nodes
            ),
        )
        for box in config.containers
    ]
    nodes = tuple(replace(process, **nothing, parameters=()) for process in config.nodes)
    return replace(config, containers=tuple(containers), nodes=nodes)


def _reduced(value: Any, secrets: Collection[str]) -> Any:
    """Leave out what nothing is decided by, and secrets."""
    if isinstance(value, dict):
        return {
            without(key, secrets) if isinstance(key, str) and key.startswith("/") else key: (
                None if key in _VALUES else each if key == _TAG else _reduced(each, secrets)
            )
            for key, each in value.items()
            if key not in _LEFT_OUT
        }
    if isinstance(value, list | tuple):
        return [_reduced(each, secrets) for each in value]
    if isinstance(value, bytes):
        return b""  # of a file
    if isinstance(value, str):
        return text_bytes(without(value, secrets)).decode()  # with escapes, as in the events
    return value


def _untyped(value: object) -> object:
    match value:
        case Path():
            return str(value)
        case Mapping():
            return dict(value)
    raise TypeError(f"{type(value).__name__} cannot be recorded")


def _typed(kind: type[Any], value: object) -> object:
    return Path(str(value)) if issubclass(kind, Path) else value
