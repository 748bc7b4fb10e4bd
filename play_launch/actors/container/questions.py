"""Questions about the nodes of a container that have been silent for too long."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final

from play_launch.core.questions import Asked, ids_to_ask, read_answer
from play_launch.wire.messages import Query

if TYPE_CHECKING:
    from collections.abc import Sequence

    from play_launch.core.questions import Answer
    from play_launch.wire.messages import NodeStatus, Status

_log = logging.getLogger(__name__)

_OPEN_QUESTIONS: Final = 16
"""Questions whose answers are still expected; older ones are dropped."""


class Questions:
    """The open questions to one container."""

    def __init__(self, container: str) -> None:
        """Take its full name."""
        self._container = container
        self._query_id = 0
        self._open: dict[int, tuple[Asked, ...]] = {}

    def clear(self) -> None:
        """The container is gone; nothing is answered any more."""
        self._open.clear()

    def put(self, asked: tuple[Asked, ...]) -> Query:
        """Make one question about all of these nodes."""
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
        """Read an answer; nothing when it was read before."""
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
