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

    def is_whole(self) -> bool:
        """Whether its file is as long as it should be."""
        try:
            return os.fstat(self.descriptor).st_size >= self.length
        except OSError:
            return False

    def messages_of(self, part: ChannelPart) -> Iterator[tuple[bytes, int]]:
        """Read data and publish time of the messages of a channel; may raise ``OSError``."""
        at = part.index_offset + INDEX.size
        entries = os.pread(self.descriptor, ENTRY.size * part.messages, at)
        for _, offset in ENTRY.iter_unpack(entries):
            begin = CHUNK_HEAD + offset
            head = os.pread(self.descriptor, MESSAGE.size, begin)
            _, length, _, _, _, publish_time = MESSAGE.unpack(head)
            size = length - (MESSAGE.size - 9)
            yield os.pread(self.descriptor, size, begin + MESSAGE.size), publish_time

    def mask(self, channels: Collection[int], secrets: re.Pattern[bytes]) -> None:
        """Write asterisks over secrets in the messages of some channels; all lengths stay.

        Raises:
            OSError, ValueError, struct.error: When the chunk is not what it should be.
        """
        parts = [part for part in self.parts if part.channel in channels]
        if not parts:
            return
        with mmap.mmap(self.descriptor, self.length) as data:
            found = False
            for part in parts:
                index = part.index_offset + INDEX.size
                entries = data[index : index + ENTRY.size * part.messages]
                for _, offset in ENTRY.iter_unpack(entries):
                    begin = CHUNK_HEAD + offset
                    end = begin + 9 + MESSAGE.unpack_from(data, begin)[1]
                    # A list, for the search holds the memory that is written to.
                    spans = secrets.finditer(data, begin + MESSAGE.size, end)
                    for secret in [each.span() for each in spans]:
                        data[slice(*secret)] = b"*" * (secret[1] - secret[0])
                        found = True
            if found:
                records = data[CHUNK_HEAD : CHUNK_HEAD + self.records_length]
                _CHECKSUM.pack_into(data, _CHECKSUM_AT, zlib.crc32(records))
