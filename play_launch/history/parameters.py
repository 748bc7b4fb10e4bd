"""The parameters of nodes, as a recording has them: what they were asked for, and what changed."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct, field

from play_launch.cdr.layout import CdrError
from play_launch.cdr.messages import NODE_PARAMETERS, PARAMETER_EVENT
from play_launch.config.model import ParameterType
from play_launch.history.events import UnreadableEventError
from play_launch.recording import topics

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from play_launch.history.bag_reader import Message

TOPICS: Final = frozenset({topics.PARAMETERS.name, topics.PARAMETER_EVENTS.name})
_TYPES: Final = {topics.PARAMETERS.type_name, topics.PARAMETER_EVENTS.type_name}
_MOST_CHANGES: Final = 1000
"""Of one node; of more, their number is kept."""
_NOT_SET: Final = 0
_LONGEST_VALUE: Final = 200
"""Characters that are shown."""


def shortened(value: str) -> str:
    """Give the beginning of a value that is too long to be read at a glance."""
    if len(value) <= _LONGEST_VALUE:
        return value
    return f"{value[:_LONGEST_VALUE]}... ({len(value):,} characters)"


class Changed(Struct, frozen=True):
    """A parameter got another value while the node was running."""

    at_ns: int
    """Log time."""
    name: str
    before: str | None
    """Values as JSON; None: not known, or not set."""
    after: str | None


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


class Parameters:
    """Takes the messages of a recording one after the other; `nodes` is what they say so far."""

    def __init__(self) -> None:
        """Know nothing yet."""
        self.nodes: dict[str, KnownParameters] = {}
        """By full name."""

    def take(self, message: Message) -> None:
        """Take a message of one of `TOPICS`; those of other types are passed over.

        Raises:
            UnreadableEventError: When the message is not what it should be.
        """
        if message.topic.type_name not in _TYPES:
            return
        try:
            if message.topic.name == topics.PARAMETERS.name:
                self._answer(NODE_PARAMETERS.read(message.data), message.log_time)
            else:
                self._event(PARAMETER_EVENT.read(message.data), message.log_time)
        except (CdrError, ValueError) as error:
            reason = f"a message of {message.topic.name} cannot be read: {error}"
            raise UnreadableEventError(reason) from error

    def _answer(self, fields: Mapping[str, Any], at_ns: int) -> None:
        values = _values(fields["parameters"])
        node = self.nodes.setdefault(fields["node"], KnownParameters())
        node.error = fields["error"]
        if not node.error:
            node.asked_ns, node.values = at_ns, values

    def _event(self, fields: Mapping[str, Any], at_ns: int) -> None:
        changed: dict[str, str | None] = dict(_values(fields["changed_parameters"]))
        changed |= dict.fromkeys(each["name"] for each in fields["deleted_parameters"])
        node = self.nodes.setdefault(fields["node"], KnownParameters())
        # What is new was declared just now: it has no value that it could differ from.
        node.values |= _values(fields["new_parameters"])
        for name, after in changed.items():
            before = node.values.pop(name, None)
            if after is not None:
                node.values[name] = after
            if before == after:
                continue
            if len(node.changes) < _MOST_CHANGES:
                node.changes.append(Changed(at_ns, name, before, after))
            else:
                node.further_changes += 1


def _values(parameters: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    found = ((each["name"], _text(each["value"])) for each in parameters)
    return {name: text for name, text in found if text is not None}


def _text(value: Mapping[str, Any]) -> str | None:
    """Give a value as JSON; a byte array as its octets in hexadecimal, in a text."""
    if value["type"] == _NOT_SET:
        return None
    given = value[ParameterType(value["type"]).field]
    return json.dumps(given.hex(" ") if isinstance(given, bytes) else given, ensure_ascii=False)
