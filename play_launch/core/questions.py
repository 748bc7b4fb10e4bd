"""Asking a container about its nodes, and reading the answer.

A question remembers which attempts it was about. So an answer that comes late, when a newer
attempt is under way, is still read as one about the old attempt.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Generic, NamedTuple, Protocol, TypeVar

from play_launch.core.node_table import NodeInput

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from play_launch.core.node_key import NodeKey


class NodeStatusState(IntEnum):
    """``play_launch_msgs/NodeStatus.state``, and one that no container sends."""

    CONSTRUCTING = 0
    LOADED = 1
    UNLOADING = 2
    QUEUED = 255
    """A load that waits on our side, in the queue of a stock container."""


class Asked(NamedTuple):
    """A node that a question is about."""

    key: NodeKey
    attempt: int
    unique_id: int
    """0 while the container has not reported it."""


class Listed(Protocol):
    """A node in the answer, as ``play_launch_msgs/NodeStatus`` has it."""

    @property
    def unique_id(self) -> int:
        """The container's number for it."""

    @property
    def attempt(self) -> int:
        """The load that it came from."""

    @property
    def state(self) -> int:
        """A :class:`NodeStatusState`, if the container makes sense."""


_ListedT = TypeVar("_ListedT", bound=Listed)


class Answer(NamedTuple, Generic[_ListedT]):
    """What the container said about one of the nodes asked for."""

    asked: Asked
    said: NodeInput
    listed: _ListedT | None
    """None when the container does not know the node."""


_SAID = {
    NodeStatusState.CONSTRUCTING: NodeInput.STATUS_CONSTRUCTING,
    NodeStatusState.LOADED: NodeInput.STATUS_LOADED,
    NodeStatusState.UNLOADING: NodeInput.STATUS_UNLOADING,
    NodeStatusState.QUEUED: NodeInput.STATUS_QUEUED,
}


def ids_to_ask(asked: Iterable[Asked]) -> tuple[int, ...]:
    """Give the unique_ids for the query; empty, which means all, where one is not known."""
    ids = tuple(each.unique_id for each in asked)
    return ids if all(ids) else ()


def read_answer(asked: Sequence[Asked], listed: Iterable[_ListedT]) -> list[Answer[_ListedT]]:
    """Say for each node asked about what the answer means.

    A node whose unique_id is listed under another attempt, or in a state without a meaning, is
    left out: that answers nothing.
    """
    by_attempt: dict[int, _ListedT] = {}
    by_id: dict[int, _ListedT] = {}
    for entry in listed:
        by_attempt.setdefault(entry.attempt, entry)
        by_id.setdefault(entry.unique_id, entry)
    answers: list[Answer[_ListedT]] = []
    for each in asked:
        found = by_attempt.get(each.attempt)
        if found is None:
            if each.unique_id == 0 or each.unique_id not in by_id:
                answers.append(Answer(each, NodeInput.STATUS_UNKNOWN, None))
        elif (said := _said(found.state)) is not None:
            answers.append(Answer(each, said, found))
    return answers


def _said(state: int) -> NodeInput | None:
    try:
        return _SAID[NodeStatusState(state)]
    except ValueError:
        return None
