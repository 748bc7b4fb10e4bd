"""Queries to a container about its nodes, and their answers.

A query keeps the attempts that it was about. So a late answer, when a newer attempt is under way,
is read as one about the old attempt.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final, Generic, NamedTuple, Protocol, TypeVar

from play_launch.supervisor.node_life import NodeFact
from play_launch.wire.messages import NodeStatusState, Query

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from play_launch.config.node_key import NodeKey
    from play_launch.wire.messages import NodeStatus, Status


class Asked(NamedTuple):
    """A node that a query is about."""

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
        """A :class:`NodeStatusState`, unless the container sent an unknown number."""


_ListedT = TypeVar("_ListedT", bound=Listed)


class Answer(NamedTuple, Generic[_ListedT]):
    """What the container reported about one of the queried nodes."""

    asked: Asked
    said: NodeFact
    listed: _ListedT | None
    """None when the container does not know the node."""


_SAID = {
    NodeStatusState.CONSTRUCTING: NodeFact.STATUS_CONSTRUCTING,
    NodeStatusState.LOADED: NodeFact.STATUS_LOADED,
    NodeStatusState.UNLOADING: NodeFact.STATUS_UNLOADING,
    NodeStatusState.QUEUED: NodeFact.STATUS_QUEUED,
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
                answers.append(Answer(each, NodeFact.STATUS_UNKNOWN, None))
        elif (said := _said(found.state)) is not None:
            answers.append(Answer(each, said, found))
    return answers


def _said(state: int) -> NodeFact | None:
    try:
        return _SAID[NodeStatusState(state)]
    except ValueError:
        return None


_log = logging.getLogger(__name__)

_OPEN_QUESTIONS: Final = 16
"""Queries whose answers are expected; older ones are dropped."""


class Questions:
    """Queries to one container that have no answer yet."""

    def __init__(self, container: str) -> None:
        """``container`` is its full name."""
        self._container = container
        self._query_id = 0
        self._open: dict[int, tuple[Asked, ...]] = {}

    def clear(self) -> None:
        """Forget all queries: the container exited."""
        self._open.clear()

    def put(self, asked: tuple[Asked, ...]) -> Query:
        """Make one query about all of these nodes."""
        if self._open:
            _log.warning(
                "%s has not answered %d question(s) about its nodes yet",
                self._container,
                len(self._open),
            )
        while len(self._open) >= _OPEN_QUESTIONS:
            del self._open[next(iter(self._open))]
        self._query_id += 1
        self._open[self._query_id] = asked
        return Query(query_id=self._query_id, unique_ids=ids_to_ask(asked))

    def read(self, status: Status) -> Sequence[Answer[NodeStatus]]:
        """Read an answer; empty if it was read before."""
        asked = self._open.pop(status.query_id, None)
        if asked is None:
            _log.debug("%s answered question %d again", self._container, status.query_id)
            return ()
        if status.dropped_frames:
            _log.warning(
                "%s has lost %d frames so far: its outgoing queue was full",
                self._container,
                status.dropped_frames,
            )
        return tuple(read_answer(asked, status.nodes))
