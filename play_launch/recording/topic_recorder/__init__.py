"""Records topics of ROS: starts the program `topic_recorder` and passes on what it makes.

Begin with :class:`.supervision.TopicRecording`. Requests for the pre-crash buffer are here, as they
need nothing of it. ``docs/decisions/recording.md#topics`` has the reasons for a program.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator


class WrittenBuffer(Struct, frozen=True):
    """What was held and is written now."""

    messages: int
    bytes: int
    seconds: float
    """That they span."""


class SnapshotError(Exception):
    """Nothing was written; the text has the cause and the fix."""


class Snapshots:
    """The place to request a snapshot, whether anything is held or not."""

    def __init__(self) -> None:
        self._take: Callable[[], Awaitable[WrittenBuffer]] | None = None

    @contextlib.contextmanager
    def taken_by(self, take: Callable[[], Awaitable[WrittenBuffer]]) -> Iterator[None]:
        """Have them taken by this while the block runs; it may raise SnapshotError."""
        self._take = take
        try:
            yield
        finally:
            self._take = None

    async def take(self) -> WrittenBuffer:
        """Have what is held written.

        Raises:
            SnapshotError: When nothing is held, or it cannot be written.
        """
        if self._take is None:
            raise SnapshotError(
                "nothing is held in memory: either the recording of topics has not begun yet, or "
                "the configuration has no record.before_crash"
            )
        return await self._take()
