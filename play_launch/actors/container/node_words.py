"""From what a container says to what that means for which of its nodes."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, NamedTuple, assert_never

from play_launch.actors.container.node_facts import (
    INPUT_OF_EVENT,
    Facts,
    facts_of_event,
    facts_of_status,
)
from play_launch.core.events import ComponentEvent
from play_launch.core.node_table import NodeInput
from play_launch.wire.messages import Accepted, Rejected, Status

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from play_launch.actors.container.node_reports import MirroredNode
    from play_launch.actors.container.questions import Questions
    from play_launch.core.node_key import NodeKey

_log = logging.getLogger(__name__)


class Word(NamedTuple):
    """An input for one node."""

    node: MirroredNode
    said: NodeInput
    facts: Facts


def words_of(
    message: Accepted | Rejected | ComponentEvent | Status,
    nodes: Mapping[NodeKey, MirroredNode],
    questions: Questions,
    container: str,
) -> Iterator[Word]:
    """Read a message; what is about nobody, or about an old attempt, is logged."""
    match message:
        case Accepted():
            facts = Facts(attempt=message.attempt, unique_id=message.unique_id)
            yield from _about_attempt(NodeInput.ACCEPTED, facts, nodes, container)
        case Rejected():
            facts = Facts(
                attempt=message.attempt, unique_id=message.unique_id, reason=message.reason
            )
            if message.attempt:
                yield from _about_attempt(NodeInput.REJECTED, facts, nodes, container)
                return
            for node in nodes.values():
                if message.unique_id and node.record.unique_id == message.unique_id:
                    yield Word(node, NodeInput.UNLOAD_REJECTED, facts)
                    return
            _log.warning("%s rejected a request: %s", container, message.reason)
        case ComponentEvent():
            if message.attempt:
                said = INPUT_OF_EVENT[message.kind]
                yield from _about_attempt(said, facts_of_event(message), nodes, container)
        case Status():
            for answer in questions.read(message):
                known = nodes.get(answer.asked.key)
                if known is not None:
                    yield Word(known, answer.said, facts_of_status(answer.asked, answer.listed))
        case _:
            assert_never(message)


def _about_attempt(
    said: NodeInput, facts: Facts, nodes: Mapping[NodeKey, MirroredNode], container: str
) -> Iterator[Word]:
    for node in nodes.values():
        if node.record.attempt == facts.attempt:
            yield Word(node, said, facts)
            return
    _log.info("%s: %s of old attempt %d is ignored", container, said, facts.attempt)
