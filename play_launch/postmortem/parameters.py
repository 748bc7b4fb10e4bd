"""The parameters of nodes, as a recording has them: what they were asked for, and what changed."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from msgspec import Struct, field

from play_launch.config.model import ParameterType
from play_launch.container.cdr.messages import NODE_PARAMETERS, PARAMETER_EVENT
from play_launch.container.cdr.structure import CdrError
from play_launch.postmortem.events import UnreadableEventError
from play_launch.recording import topics

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from play_launch.postmortem.bag_reader import Message

TOPICS: Final = frozenset({topics.PARAMETERS.name, topics.PARAMETER_EVENTS.name})
_TYPES: Final = {topics.PARAMETERS.type_name, topics.PARAMETER_EVENTS.type_name}
_MOST_CHANGES: Final = 1000
"""Of one node; of more, their number is kept."""
_NOT_SET: Final = 0
_LONGEST_VALUE: Final = 200
"""Characters that are shown."""
_OF_EVERY_NODE: Final = ("use_sim_time", "start_type_description_service", "qos_overrides.")
"""What the names of parameters begin with that client libraries declare in every node."""


def shortened(value: str, longest: int = _LONGEST_VALUE) -> str:
    """Give the beginning of a value that is too long to be read at a glance."""
    if len(value) <= longest:
        return value
    return f"{value[:longest]}... ({len(value):,} characters)"


def is_of_the_node(name: str) -> bool:
    """Whether a parameter is the node's own, and not one that every node has."""
    return not name.startswith(_OF_EVERY_NODE)


class Changed(Struct, frozen=True):
    """A parameter got another value while the node was running."""

    at_ns: int
    """Log time."""
    name: str
    before: str | None
    """Values as JSON; None: not known, or not set."""
    after: str | None


class ParametersOfALife(Struct, frozen=True):
    """What is known of a node between a start and an end of it."""

    values: tuple[tuple[str, str], ...] = ()
    """Names, in their order, with values as JSON; empty where it did not answer in this life."""
    changes: tuple[Changed, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.values or self.changes)


class KnownParameters(Struct):
    """What is known of one node."""

    asked_ns: int = 0
    """Log time of its latest answer; 0: it never gave one."""
    error: str = ""
    """Why it gave no answer when it was asked last."""
    values: dict[str, str] = field(default_factory=dict)
    """The latest ones, as JSON; without an answer only those that changed."""
    changes: list[Changed] = field(default_factory=list)
    further_changes: int = 0

    def of_life(self, begin_ns: int) -> ParametersOfALife:
        """Give what was said since `begin_ns`: a start sets everything back."""
        values = sorted(self.values.items()) if self.asked_ns >= begin_ns else ()
        changes = tuple(each for each in self.changes if each.at_ns >= begin_ns)
        return ParametersOfALife(tuple(values), changes)


class RecordedParameter(NamedTuple):
    """What one message says about the parameters of a node."""

    node: str
    values: Mapping[str, str] | None = None
    """All of them, as JSON; None: it is not their answer."""
    changes: Sequence[Changed] = ()
    error: str = ""
    """Why there is no answer."""

    def __bool__(self) -> bool:
        return self.values is not None or bool(self.changes or self.error)


class Parameters:
    """Takes the messages of a recording one after the other; `nodes` is the result so far."""

    def __init__(self) -> None:
        self.nodes: dict[str, KnownParameters] = {}
        """By full name."""

    def take(self, message: Message) -> RecordedParameter | None:
        """Take a message of one of `TOPICS` and give what is in it; None for those of other types.

        Raises:
            UnreadableEventError: When the message is not what it should be.
        """
        if message.topic.type_name not in _TYPES:
            return None
        try:
            if message.topic.name == topics.PARAMETERS.name:
                return self._answer(NODE_PARAMETERS.read(message.data), message.log_time)
            return self._event(PARAMETER_EVENT.read(message.data), message.log_time)
        except (CdrError, ValueError) as error:
            reason = f"a message of {message.topic.name} cannot be read: {error}"
            raise UnreadableEventError(reason) from error

    def _answer(self, fields: Mapping[str, Any], at_ns: int) -> RecordedParameter:
        values = _values(fields["parameters"])
        node = self.nodes.setdefault(fields["node"], KnownParameters())
        node.error = fields["error"]
        if node.error:
            return RecordedParameter(fields["node"], error=node.error)
        node.asked_ns, node.values = at_ns, values
        return RecordedParameter(fields["node"], dict(values))

    def _event(self, fields: Mapping[str, Any], at_ns: int) -> RecordedParameter:
        changed: dict[str, str | None] = dict(_values(fields["changed_parameters"]))
        changed |= dict.fromkeys(each["name"] for each in fields["deleted_parameters"])
        node = self.nodes.setdefault(fields["node"], KnownParameters())
        # What is new was declared just now: it has no value that it could differ from.
        node.values |= _values(fields["new_parameters"])
        found = []
        for name, after in changed.items():
            before = node.values.pop(name, None)
            if after is not None:
                node.values[name] = after
            if before != after:
                found.append(Changed(at_ns, name, before, after))
        room = max(0, _MOST_CHANGES - len(node.changes))
        node.changes += found[:room]
        node.further_changes += len(found[room:])
        return RecordedParameter(fields["node"], changes=found)


def _values(parameters: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    found = ((each["name"], _text(each["value"])) for each in parameters)
    return {name: text for name, text in found if text is not None}


def _text(value: Mapping[str, Any]) -> str | None:
    """Give a value as JSON; a byte array as its octets in hexadecimal, in a text."""
    if value["type"] == _NOT_SET:
        return None
    given = value[ParameterType(value["type"]).field]
    return json.dumps(given.hex(" ") if isinstance(given, bytes) else given, ensure_ascii=False)
