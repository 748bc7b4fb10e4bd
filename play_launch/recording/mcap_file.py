"""The records of an MCAP file, in their order: data, then the summary that indexes it.

The package ``mcap`` encodes them. Its writer puts them in order as well, but it owns the stream and
the index: a finished chunk has no way in, and each chunk of a long recording would
stay in memory as an object of its own.
"""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING, Final

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from zstandard import ZstdCompressor

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Protocol

    from play_launch.recording.chunk import TopicChunk

    class Sink(Protocol):
        """Where the bytes go; ``size`` is how many there are."""

        size: int

        def append(self, data: bytes) -> None:
            """Take the next bytes."""

        def append_file(self, descriptor: int, length: int) -> None:
            """Take the beginning of a file, now."""


MAGIC: Final = b"\x89MCAP0\r\n"
_MESSAGE: Final = struct.Struct("<BQHIQQ")
"""Kind, length, channel, sequence number, log time, publish time; the data follows."""
_MESSAGE_HEAD: Final = _MESSAGE.size - 9
"""What counts into the length."""
_CHUNK: Final = struct.Struct("<BQQQQII4sQ")
"""Kind, length, first and last log time, size, checksum, a name and its length, compressed size."""
_CHUNK_HEAD: Final = _CHUNK.size - 9
_INDEX: Final = struct.Struct("<BQHI")
_INDEX_ENTRY: Final = struct.Struct("<QQ")
_FOOTER: Final = struct.Struct("<BQQQ")
_ZSTD: Final = b"zstd"


class McapFile:
    """Appends records to a sink; nothing else writes there.

    Descriptions of schemas and channels stand outside of chunks, so that a broken chunk takes no
    other along. Numbers of schemas and channels are the caller's.
    """

    def __init__(self, sink: Sink, *, library: str) -> None:
        """Write the head."""
        self._sink = sink
        self._compressor = ZstdCompressor(level=3)
        self._chunk = bytearray()
        self._chunk_begin = self._chunk_end = 0
        self._chunk_index: dict[int, bytearray] = {}
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._chunks = bytearray()
        self._attachments = bytearray()
        self._metadata = bytearray()
        self._count = dict.fromkeys(("chunk", "attachment", "metadata"), 0)
        self.counts: dict[int, int] = {}
        """Messages of each channel, those of the unfinished chunk included."""
        self.begin = 0
        self.end = 0
        """Log times of the earliest and the latest message; 0 without any."""
        sink.append(MAGIC + _encoded(Header("ros2", library)))

    @property
    def unfinished(self) -> int:
        """Bytes in the unfinished chunk, uncompressed."""
        return len(self._chunk)

    def describe_schema(self, schema: Schema) -> None:
        """Write a schema, before a channel that has it."""
        self._schemas.append(_encoded(schema))
        self._sink.append(self._schemas[-1])

    def describe_channel(self, channel: Channel) -> None:
        """Write a channel, before any message of it."""
        self._channels.append(_encoded(channel))
        self.counts[channel.id] = 0
        self._sink.append(self._channels[-1])

    def add(
        self, channel: int, sequence: int, log_time: int, publish_time: int, data: bytes
    ) -> None:
        """Put a message into the unfinished chunk."""
        index = self._chunk_index.get(channel)
        if index is None:
            index = self._chunk_index[channel] = bytearray()
        index += _INDEX_ENTRY.pack(log_time, len(self._chunk))
        if not self._chunk:
            self._chunk_begin = self._chunk_end = log_time
        elif log_time < self._chunk_begin:
            self._chunk_begin = log_time
        elif log_time > self._chunk_end:
            self._chunk_end = log_time
        self.counts[channel] += 1
        self._chunk += _MESSAGE.pack(
            Opcode.MESSAGE,
            _MESSAGE_HEAD + len(data),
            channel,
            sequence & 0xFFFFFFFF,
            log_time,
            publish_time,
        )
        self._chunk += data

    def end_chunk(self) -> None:
        """Write the unfinished chunk, if there is anything in it, and its index."""
        if not self._chunk:
            return
        size, checksum = len(self._chunk), zlib.crc32(self._chunk)
        compressed = self._compressor.compress(self._chunk)
        start = self._sink.size
        self._sink.append(
            _CHUNK.pack(
                Opcode.CHUNK,
                _CHUNK_HEAD + len(compressed),
                self._chunk_begin,
                self._chunk_end,
                size,
                checksum,
                len(_ZSTD),
                _ZSTD,
                len(compressed),
            )
            + compressed
        )
        chunk_length = self._sink.size - start
        offsets = self._end_index()
        index = ChunkIndex(
            message_start_time=self._chunk_begin,
            message_end_time=self._chunk_end,
            chunk_start_offset=start,
            chunk_length=chunk_length,
            message_index_offsets=offsets,
            message_index_length=self._sink.size - start - chunk_length,
            compression=_ZSTD.decode(),
            compressed_size=len(compressed),
            uncompressed_size=size,
        )
        self._index_chunk(index)
        self._chunk = bytearray()

    def append_chunk(self, chunk: TopicChunk) -> None:
        """Write a finished chunk; what is before it is to be written already."""
        start = self._sink.size
        self._sink.append_file(chunk.descriptor, chunk.length)
        self._index_chunk(
            ChunkIndex(
                message_start_time=chunk.begin,
                message_end_time=chunk.end,
                chunk_start_offset=start,
                chunk_length=chunk.chunk_length,
                message_index_offsets={
                    part.channel: start + part.index_offset for part in chunk.parts
                },
                message_index_length=chunk.length - chunk.chunk_length,
                compression="",
                compressed_size=chunk.records_length,
                uncompressed_size=chunk.records_length,
            )
        )
        for part in chunk.parts:
            self.counts[part.channel] += part.messages

    def attach(self, attachment: Attachment) -> None:
        """Write a file of its own."""
        start, data = self._sink.size, _encoded(attachment)
        self._sink.append(data)
        index = AttachmentIndex(
            offset=start,
            length=len(data),
            create_time=attachment.create_time,
            log_time=attachment.log_time,
            data_size=len(attachment.data),
            name=attachment.name,
            media_type=attachment.media_type,
        )
        self._attachments += _encoded(index)
        self._count["attachment"] += 1

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a record of names and values."""
        start, data = self._sink.size, _encoded(Metadata(name, dict(values)))
        self._sink.append(data)
        self._metadata += _encoded(MetadataIndex(offset=start, length=len(data), name=name))
        self._count["metadata"] += 1

    def finish(self) -> None:
        """Write the rest, the summary and the end."""
        self.end_chunk()
        self._sink.append(_encoded(DataEnd(0)))
        start = self._sink.size
        summary = bytearray()
        offsets = bytearray()
        for kind, group in (
            (Opcode.SCHEMA, b"".join(self._schemas)),
            (Opcode.CHANNEL, b"".join(self._channels)),
            (Opcode.STATISTICS, _encoded(self._statistics())),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ):
            if group:
                offsets += _encoded(SummaryOffset(kind, start + len(summary), len(group)))
                summary += group
        offset_start = start + len(summary)
        summary += offsets
        checksum = zlib.crc32(
            _FOOTER.pack(Opcode.FOOTER, 8 + 8 + 4, start, offset_start), zlib.crc32(summary)
        )
        footer = Footer(
            summary_start=start, summary_offset_start=offset_start, summary_crc=checksum
        )
        self._sink.append(bytes(summary) + _encoded(footer) + MAGIC)

    def _index_chunk(self, index: ChunkIndex) -> None:
        self._chunks += _encoded(index)
        begin = index.message_start_time
        self.begin = begin if self._count["chunk"] == 0 else min(self.begin, begin)
        self.end = max(self.end, index.message_end_time)
        self._count["chunk"] += 1

    def _end_index(self) -> dict[int, int]:
        offsets: dict[int, int] = {}
        for channel, entries in self._chunk_index.items():
            offsets[channel] = self._sink.size
            length = _INDEX.size - 9 + len(entries)
            head = _INDEX.pack(Opcode.MESSAGE_INDEX, length, channel, len(entries))
            self._sink.append(head + entries)
        self._chunk_index = {}
        return offsets

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=self._count["attachment"],
            channel_count=len(self._channels),
            channel_message_counts={each: count for each, count in self.counts.items() if count},
            chunk_count=self._count["chunk"],
            message_count=sum(self.counts.values()),
            message_start_time=self.begin,
            message_end_time=self.end,
            metadata_count=self._count["metadata"],
            schema_count=len(self._schemas),
        )


def _encoded(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
