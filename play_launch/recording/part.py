"""One file of a recording, from its first byte until it has its final name."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import time
from typing import TYPE_CHECKING, Final

from mcap.records import Attachment, Channel, Schema
from msgspec import Struct

from play_launch.recording.appending_file import AppendingFile, sync_folder
from play_launch.recording.mcap_file import McapFile

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from play_launch.recording.chunk import TopicChunk
    from play_launch.recording.topics import Topic

ACTIVE_SUFFIX: Final = ".active"
"""Appended to the name of a file while it is written."""

HALF_SUFFIX: Final = ".recovering"
"""Appended to the name of a file while it is recovered."""

_CHUNK_SIZE: Final = 960 * 1024
"""Bytes, uncompressed. The chunk ends *after* the message that exceeds it; the distance to 1 MiB
is for that message."""
_NUMBERED: Final = re.compile(r"(?P<stem>.*?)(?:_(?P<number>[1-9][0-9]{0,8}))?\.mcap")


def part_path(first: Path, number: int) -> Path:
    """``session.mcap`` for 0, then ``session_1.mcap`` and so on."""
    return first if number == 0 else first.with_name(f"{first.stem}_{number}{first.suffix}")


def part_number(name: str) -> int | None:
    """The number of a part, by its final name; None where it is no name of one."""
    found = _NUMBERED.fullmatch(name)
    return None if found is None else int(found["number"] or 0)


class PartSummary(Struct, frozen=True):
    """What a file holds; times are nanoseconds since the epoch."""

    begin: int
    end: int
    """Log times of the earliest and the latest message; 0 without any."""
    counts: Mapping[int, int]
    """Messages by channel."""


class Part:
    """Writes ``<path>.active``, which gets its final name when it is complete.

    Methods may raise ``OSError``. When one does, nothing is lost: the file is as it was after the
    last :meth:`commit`, and the next one goes on.
    """

    def __init__(self, path: Path, *, library: str) -> None:
        """Create the file; it must not exist."""
        self._final_path = path
        self.path = path.with_name(path.name + ACTIVE_SUFFIX)
        """Where the data is now; it changes once, when the file is complete and on the disk."""
        self.file = AppendingFile(self.path)
        self.begun = time.monotonic()
        """In seconds of the monotonic clock."""
        self._mcap = McapFile(self.file, library=library)
        self._schemas: dict[str, int] = {}
        self._sequences: dict[int, int] = {}
        self._messages = 0
        self.committed_messages = 0
        self._name_is_durable = False

    @property
    def messages(self) -> int:
        """Messages that it has got; see ``committed_messages``."""
        return self._messages

    def register(self, channel: int, topic: Topic, definition: str) -> None:
        """Announce a topic under this number."""
        schema = self._schemas.get(topic.type_name)
        if schema is None:
            schema = self._schemas[topic.type_name] = len(self._schemas) + 1
            data = definition.encode()
            self._mcap.describe_schema(Schema(schema, data, "ros2msg", topic.type_name))
        self._mcap.describe_channel(
            Channel(
                id=channel,
                topic=topic.name,
                message_encoding="cdr",
                metadata=topic.metadata,
                schema_id=schema,
            )
        )

    def write(
        self,
        channel: int,
        data: bytes,
        *,
        log_time: int,
        publish_time: int,
        sequence: int | None = None,
    ) -> None:
        """Append one message; a full chunk goes to the file at once.

        Messages of a channel are numbered from 1 on, unless ``sequence`` says otherwise.
        """
        if sequence is None:
            sequence = self._sequences[channel] = self._sequences.get(channel, 0) + 1
        self._mcap.add(channel, sequence, log_time, publish_time, data)
        self._messages += 1
        if self._mcap.unfinished > _CHUNK_SIZE:
            self.commit()

    def append_chunk(self, chunk: TopicChunk) -> None:
        """Append messages that are in a chunk already, after those before."""
        self.commit()
        self._mcap.append_chunk(chunk)
        self._messages += chunk.messages
        self.committed_messages = self._messages

    def attach(self, name: str, media_type: str, data: bytes, *, time: int) -> None:
        """Put a file of its own into the bag."""
        self._mcap.attach(
            Attachment(
                create_time=time,
                log_time=time,
                name=_text(name),
                media_type=media_type,
                data=data,
            )
        )

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Put a record of names and values into the bag."""
        self._mcap.metadata(name, {key: _text(value) for key, value in values.items()})

    def commit(self) -> None:
        """End the chunk, and hand everything over to the kernel."""
        self._mcap.end_chunk()
        self.file.commit()
        self.committed_messages = self._messages

    def finish(self) -> PartSummary:
        """Write the rest and the summary; :meth:`complete` is to follow.

        When there is no room for the summary, the file goes on without it.
        """
        self.commit()
        self._mcap.finish()
        try:
            self.file.commit()
        except OSError:
            self.file.forget_held()
            raise
        counts = dict(self._mcap.counts)
        return PartSummary(self._mcap.begin, self._mcap.end, counts)

    def sync(self) -> None:
        """Force to the disk what the kernel has got; in any thread.

        Raises:
            FileNotFoundError: When the file was removed.
            OSError: When it cannot be done.
        """
        self.file.sync()
        if self.file.is_removed:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self.path))
        if not self._name_is_durable:
            # A file that is synced may still be without a name after a power failure.
            sync_folder(self.path.parent)
            self._name_is_durable = True

    def complete(self) -> None:
        """Make the file durable, give it its final name and close it; in any thread."""
        try:
            self.file.sync()
            self.path.rename(self._final_path)
            self.path = self._final_path
        finally:
            # Its lock says that it is being written, and ends with this.
            self.file.close()
        sync_folder(self.path.parent)

    def abandon(self) -> None:
        """Cut the file after the last complete record and close it. Never raises."""
        self.file.forget_held()
        with contextlib.suppress(OSError):
            self.file.close()


def _text(text: str) -> str:
    """Text as MCAP can hold it: a file name that is not Unicode is written with escapes."""
    return text.encode("utf-8", "backslashreplace").decode()
