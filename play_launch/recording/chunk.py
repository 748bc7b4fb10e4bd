"""A chunk that `topic_recorder` has made, as it will stand in the file."""

from __future__ import annotations

import mmap
import os
import struct
import zlib
from typing import TYPE_CHECKING, Final

from msgspec import Struct

if TYPE_CHECKING:
    import re
    from collections.abc import Collection, Iterator

CHUNK_HEAD: Final = 9 + 8 + 8 + 8 + 4 + 4 + 8
"""Bytes of an uncompressed chunk before its records."""
INDEX: Final = struct.Struct("<BQHI")
"""Head of a message index; entries follow."""
ENTRY: Final = struct.Struct("<QQ")
"""Log time, and offset of the message among the records."""
MESSAGE: Final = struct.Struct("<BQHIQQ")
"""Kind, length, channel, sequence number, log time, publish time; the data follows."""
_CHECKSUM: Final = struct.Struct("<I")
_CHECKSUM_AT: Final = 9 + 8 + 8 + 8


class ChannelPart(Struct, frozen=True):
    """The messages of one channel in a chunk."""

    channel: int
    messages: int
    index_offset: int
    """Where its message index begins, in bytes from the beginning of the chunk."""


class TopicChunk(Struct, frozen=True):
    """An uncompressed chunk record, then the message indexes that belong to it, in a file.

    Lengths are bytes; ``begin`` and ``end`` are the log times of the earliest and the latest
    message.
    """

    descriptor: int
    """Of the file; the receiver of the chunk closes it."""
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

    def checked(self, channels: Collection[int], secrets: re.Pattern[bytes] | None) -> str:
        """Mask secrets in some channels; return why it cannot be recorded, empty if it can."""
        try:
            if os.fstat(self.descriptor).st_size < self.length:
                return "its memory is too short"
        except OSError as error:
            return f"its memory cannot be read: {error}"
        if secrets is not None:
            try:
                self._mask(channels, secrets)
            except (OSError, ValueError, struct.error) as error:
                return f"it may hold secrets: {error}"
        return ""

    def messages_of(self, part: ChannelPart) -> Iterator[tuple[bytes, int]]:
        """Read data and publish time of the messages of a channel.

        Raises:
            OSError, ValueError, struct.error: When the chunk is not what it should be.
        """
        with mmap.mmap(self.descriptor, self.length, access=mmap.ACCESS_READ) as data:
            for begin, end, publish_time in _messages(data, part):
                yield data[begin:end], publish_time

    def _mask(self, channels: Collection[int], secrets: re.Pattern[bytes]) -> None:
        """Write asterisks over secrets in the messages of some channels; all lengths stay.

        Raises OSError, ValueError or struct.error when the chunk is not what it should be.
        """
        parts = [part for part in self.parts if part.channel in channels]
        if not parts:
            return
        with mmap.mmap(self.descriptor, self.length) as data:
            # Lists, for the search holds the memory that is written to.
            found = [
                match.span()
                for part in parts
                for begin, end, _ in _messages(data, part)
                for match in list(secrets.finditer(data, begin, end))
            ]
            for begin, end in found:
                data[begin:end] = b"*" * (end - begin)
            if found:
                records = data[CHUNK_HEAD : CHUNK_HEAD + self.records_length]
                _CHECKSUM.pack_into(data, _CHECKSUM_AT, zlib.crc32(records))


def _messages(data: mmap.mmap, part: ChannelPart) -> Iterator[tuple[int, int, int]]:
    """Return begin and end of the data of each message of a channel, and its publish time."""
    at = part.index_offset + INDEX.size
    for _, offset in ENTRY.iter_unpack(data[at : at + ENTRY.size * part.messages]):
        begin = CHUNK_HEAD + offset
        _, length, _, _, _, publish_time = MESSAGE.unpack_from(data, begin)
        yield begin + MESSAGE.size, begin + 9 + length, publish_time
