"""What happened in a session, from its recording."""

from __future__ import annotations

import json
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

from play_launch.postmortem.bag_reader import BagReader
from play_launch.postmortem.events import UnreadableEventError, event_of
from play_launch.recording.topics import APPLIED, METADATA_NAME, RESOLVED

if TYPE_CHECKING:
    from collections.abc import Container, Iterator
    from pathlib import Path

    from play_launch.postmortem.bag_reader import Message
    from play_launch.supervisor.events import RunEvent


class RecordedEvent(NamedTuple):
    """One event, and when it was received."""

    log_time: int
    event: RunEvent


class PastSession:
    """One pass over a recording, after which `reader` is whole."""

    def __init__(self, path: Path) -> None:
        self.reader = BagReader(path)

    @property
    def about(self) -> dict[str, str]:
        """What the recording says about itself (`play_launch.session`); empty where it does not."""
        return self.reader.metadata.get(METADATA_NAME, {})

    @property
    def started_ns(self) -> int:
        """Nanoseconds since the epoch; that of the earliest message where nothing else is known."""
        stamp = self.about.get("started_ns", "")
        is_number = stamp.isascii() and stamp.isdecimal() and len(stamp) < 20
        return (int(stamp) if is_number else 0) or self.reader.begin

    @cached_property
    def resolved(self) -> dict[str, Any]:
        """The configuration as it was resolved; empty where it cannot be read.

        It stands before the first message: it is asked for when there was one.
        """
        return self._configuration(RESOLVED)

    @property
    def applied(self) -> list[dict[str, Any]]:
        """The configurations that were applied, as far as it was read, in their order."""
        names = [each for each in self.reader.attachments if each.startswith(APPLIED)]
        return [self._configuration(each) for each in names if each.endswith(f"/{RESOLVED}")]

    def _configuration(self, attachment: str) -> dict[str, Any]:
        try:
            found = json.loads(self.reader.attachments[attachment].data)
        except (KeyError, ValueError, RecursionError):
            return {}
        return found if isinstance(found, dict) else {}

    def events(self, topics: Container[str] | None = None) -> Iterator[RecordedEvent]:
        """Give the events of these topics (None: all) in the order in which they were received.

        Raises:
            NotARecordingError: At once, for another kind of file.
        """
        for message in self.reader.messages(topics):
            event = self.event(message)
            if event is not None:
                yield RecordedEvent(message.log_time, event)

    def event(self, message: Message) -> RunEvent | None:
        """Read the event of a message; None without one, or where it cannot be read."""
        try:
            return event_of(message)
        except UnreadableEventError as error:
            self.reader.damaged(str(error))
            return None
