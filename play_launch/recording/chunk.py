"""A chunk that another process has made, as it will stand in the file."""

from __future__ import annotations

from msgspec import Struct


class ChannelPart(Struct, frozen=True):
    """The messages of one channel in a chunk."""

    channel: int
    messages: int
    index_offset: int
    """Where its message index begins, in bytes from the beginning of the chunk."""


class TopicChunk(Struct, frozen=True):
    """An uncompressed chunk record, then the message indexes that belong to it, in a file.

    Lengths are bytes; ``begin`` and ``end`` are the log times of the earliest and the latest
    message, in nanoseconds since the epoch.
    """

    descriptor: int
    """Of the file; who takes the chunk closes it."""
    length: int
    """Of everything."""
    chunk_length: int
    """Of the chunk record with its head."""
    records_length: int
    """Of the records in it."""
    begin: int
    end: int
    parts: tuple[ChannelPart, ...]

    @property
    def messages(self) -> int:
        """How many messages are in it."""
        return sum(part.messages for part in self.parts)
