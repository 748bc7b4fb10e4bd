"""Queries to a container about its nodes, and their answers.

A query keeps the attempts that it was about. So a late answer, when a newer attempt is under way,
is read as one about the old attempt.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.container.messages import NodeStatusState, Query
from play_launch.supervisor.node_life import NodeFact

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.config.node_key import NodeKey
    from play_launch.container.messages import NodeStatus, Status

_log = logging.getLogger(__name__)

_MOST_OPEN: Final = 16
"""Queries whose answers are expected; older ones are dropped."""
_SAID: Final = {
    NodeStatusState.CONSTRUCTING: NodeFact.STATUS_CONSTRUCTING,
    NodeStatusState.LOADED: NodeFact.STATUS_LOADED,
    NodeStatusState.UNLOADING: NodeFact.STATUS_UNLOADING,
    NodeStatusState.QUEUED: NodeFact.STATUS_QUEUED,
}


class Asked(NamedTuple):
    """A node that a query is about."""

    key: NodeKey
    attempt: int
    unique_id: int
    """0 while the container has not reported it."""


class Queries:
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
            text = "%s has not answered %d question(s) about its nodes yet"
            _log.warning(text, self._container, len(self._open))
        while len(self._open) >= _MOST_OPEN:
            del self._open[next(iter(self._open))]
        self._query_id += 1
        self._open[self._query_id] = asked
        ids = tuple(each.unique_id for each in asked)
        # Without ids it is about all nodes.
        return Query(query_id=self._query_id, unique_ids=ids if all(ids) else ())

    def read(self, status: Status) -> Iterator[tuple[Asked, NodeFact, NodeStatus | None]]:
        """Read an answer for each node that was asked about; the status is None for an unknown one.

        A node whose unique_id is listed under another attempt is left out: that answers nothing.
        """
        if status.dropped_frames:
            text = "%s has lost %d frames so far: its outgoing queue was full"
            _log.warning(text, self._container, status.dropped_frames)
        by_attempt = {node.attempt: node for node in status.nodes}
        ids = {node.unique_id for node in status.nodes if node.unique_id}
        for asked in self._open.pop(status.query_id, ()):
            if node := by_attempt.get(asked.attempt):
                yield asked, _SAID[node.state], node
            elif asked.unique_id not in ids:
                yield asked, NodeFact.STATUS_UNKNOWN, None
