"""One MCAP file of a recording; it grows by whole chunks only, whatever the disk does."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import struct
import time
import zlib
from collections import defaultdict
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

from play_launch.container.cdr.structure import text_bytes
from play_launch.recording.chunk import ENTRY, INDEX, MESSAGE
from play_launch.recording.errors import WriteFailedError
from play_launch.recording.folder import ACTIVE_SUFFIX, MAGIC

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from play_launch.recording.chunk import TopicChunk
    from play_launch.recording.topics import Topic

CHUNK_SIZE: Final = 960 * 1024
"""Bytes, uncompressed. A chunk ends after the message that exceeds it: 64 KiB are left for that."""
_CHUNK: Final = struct.Struct("<BQQQQII4sQ")
"""Kind, length, first and last log time, size, checksum, a name and its length, compressed size."""
_ZSTD: Final = b"zstd"
_SUMMARY: Final = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)
"""Kinds of records in the summary, in their order."""
_CHECKSUM: Final = 4
"""Bytes of a checksum, at the end of a footer."""
_ROOM: Final = 4 * 1024 * 1024
"""Bytes that have to be free before a file is tried again: with less it would soon fail again."""
_SHARE: Final = 80
"""On a small file system this part of it is enough."""


class McapFile:
    """Writes ``<path>.active``, which is renamed to ``path`` when it is complete.

    Data is held back until :meth:`commit`, which writes all of it or nothing: on a full disk the
    file ends after the commit before, and a later one continues. While it is open the file is
    locked (``flock``), by which readers know that it is written. What writes may raise
    ``WriteFailedError``.

    The package ``mcap`` encodes all records but chunks, which are packed here: three times as fast,
    and those of `topic_recorder` are finished already. Its writer has no way in for such a chunk,
    and its import costs the start 40 ms. Schemas and channels stand outside of chunks, so that a
    broken chunk loses its own messages only.
    """

    def __init__(self, path: Path) -> None:
        """Create the file; it must not exist."""
        self._final_path = path
        self.path = path.with_name(path.name + ACTIVE_SUFFIX)
        """Where the data is now."""
        self._descriptor = -1
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        try:
            self._descriptor = os.open(self.path, flags, 0o644)
        except OSError as error:
            raise WriteFailedError(self.path, error) from error
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self.begun = time.monotonic()
        self._held: list[bytes | bytearray] = []
        self.size = 0
        """Bytes, those that are held back included."""
        self.committed = 0
        """Bytes that are in the file."""
        self.messages = 0
        self.committed_messages = 0
        self._chunk = bytearray()
        self._chunk_begin = self._chunk_end = 0
        self._entries: dict[int, bytearray] = {}
        """Index of the unfinished chunk, by channel."""
        self._sequences: dict[int, int] = {}
        self._schemas: dict[str, int] = {}
        self._compressor = ZstdCompressor(level=3)
        self._has_name = False
        """Whether the name is durable; a file that is synced may be without one."""
        self.statistics = Statistics(
            attachment_count=0,
            channel_count=0,
            channel_message_counts=defaultdict(int),
            chunk_count=0,
            message_count=0,
            message_end_time=0,
            message_start_time=0,
            metadata_count=0,
            schema_count=0,
        )
        self._summary: dict[Opcode, list[bytes]] = {kind: [] for kind in _SUMMARY}
        self._hold(MAGIC + _encoded(Header("ros2", "play_launch")))

    def _hold(self, data: bytes) -> None:
        self._held.append(data)
        self.size += len(data)

    def register(self, topic: Topic, definition: str) -> int:
        """Describe a topic; return its channel. Channels are numbered from 1 on."""
        schema = self._schemas.get(topic.type_name)
        known = self.statistics
        if schema is None:
            known.schema_count += 1
            schema = self._schemas[topic.type_name] = known.schema_count
            self._describe(
                Opcode.SCHEMA,
                Schema(
                    id=schema, data=definition.encode(), encoding="ros2msg", name=topic.type_name
                ),
            )
        known.channel_count += 1
        channel = Channel(
            id=known.channel_count,
            topic=topic.name,
            message_encoding="cdr",
            metadata=dict(topic.metadata),
            schema_id=schema,
        )
        self._describe(Opcode.CHANNEL, channel)
        return channel.id

    def _describe(self, kind: Opcode, record: McapRecord) -> None:
        data = _encoded(record)
        self._hold(data)
        self._summary[kind].append(data)

    def attach(self, name: str, media_type: str, data: bytes, *, time: int) -> None:
        name, start = _text(name), self.size
        self._hold(_encoded(Attachment(time, time, name, media_type, data)))
        index = AttachmentIndex(
            offset=start,
            length=self.size - start,
            log_time=time,
            create_time=time,
            data_size=len(data),
            name=name,
            media_type=media_type,
        )
        self._summary[Opcode.ATTACHMENT_INDEX].append(_encoded(index))
        self.statistics.attachment_count += 1

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        start = self.size
        texts = {key: _text(value) for key, value in values.items()}
        self._hold(_encoded(Metadata(name, texts)))
        index = MetadataIndex(start, self.size - start, name)
        self._summary[Opcode.METADATA_INDEX].append(_encoded(index))
        self.statistics.metadata_count += 1

    def add(
        self,
        channel: int,
        data: bytes,
        *,
        log_time: int,
        publish_time: int,
        sequence: int | None = None,
    ) -> None:
        """Put a message into the unfinished chunk; those of a channel are numbered from 1 on."""
        if sequence is None:
            sequence = self._sequences[channel] = self._sequences.get(channel, 0) + 1
        entries = self._entries.get(channel)
        if entries is None:
            entries = self._entries[channel] = bytearray()
        chunk = self._chunk
        entries += ENTRY.pack(log_time, len(chunk))
        if not chunk:
            self._chunk_begin = self._chunk_end = log_time
        elif log_time < self._chunk_begin:
            self._chunk_begin = log_time
        elif log_time > self._chunk_end:
            self._chunk_end = log_time
        length = MESSAGE.size - 9 + len(data)
        chunk += MESSAGE.pack(
            Opcode.MESSAGE, length, channel, sequence & 0xFFFFFFFF, log_time, publish_time
        )
        chunk += data
        self.messages += 1
        if len(chunk) > CHUNK_SIZE:
            self._end_chunk()

    def append_chunk(self, chunk: TopicChunk) -> None:
        """Append a finished chunk, now; the kernel copies it while other threads continue.

        When it fails, nothing of the chunk is in the file.
        """
        self.commit()
        at = 0
        try:
            os.lseek(self._descriptor, self.committed, os.SEEK_SET)
            while at < chunk.length:
                count = os.sendfile(self._descriptor, chunk.descriptor, at, chunk.length - at)
                if count == 0:
                    raise OSError(errno.EIO, f"{at} of {chunk.length} bytes came")  # noqa: TRY301
                at += count
        except OSError as error:
            self._cut()
            raise WriteFailedError(self.path, error) from error
        index = ChunkIndex(
            message_start_time=chunk.begin,
            message_end_time=chunk.end,
            chunk_start_offset=self.committed,
            chunk_length=chunk.chunk_length,
            message_index_offsets={
                part.channel: self.committed + part.index_offset for part in chunk.parts
            },
            message_index_length=chunk.length - chunk.chunk_length,
            compression="",
            compressed_size=chunk.records_length,
            uncompressed_size=chunk.records_length,
        )
        self._note_chunk(index, {part.channel: part.messages for part in chunk.parts})
        self.size = self.committed = self.committed + chunk.length
        self.messages += chunk.messages
        self.committed_messages = self.messages

    def commit(self) -> None:
        """End the chunk, and pass everything to the kernel, in one piece."""
        self._end_chunk()
        if not self._held:
            return
        whole = b"".join(self._held)
        self._held = [whole]
        rest, at = memoryview(whole), self.committed
        try:
            while rest:
                count = os.pwrite(self._descriptor, rest, at)
                at += count
                rest = rest[count:]
        except OSError as error:
            self._cut()
            raise WriteFailedError(self.path, error) from error
        self._held = []
        self.committed = at
        self.committed_messages = self.messages

    def finish(self) -> None:
        """Write the rest and the summary; :meth:`complete` is to follow."""
        self.commit()
        self._hold(_encoded(DataEnd(0)))
        self._summary[Opcode.STATISTICS] = [_encoded(self.statistics)]
        start = at = self.size
        offsets = b""
        for kind in _SUMMARY:
            records = self._summary[kind]
            length = sum(map(len, records))
            if length:
                offsets += _encoded(SummaryOffset(kind, at, length))
            at += length
        summary = b"".join([*(each for kind in _SUMMARY for each in self._summary[kind]), offsets])
        # The checksum of the summary counts the footer up to itself.
        footer = _encoded(Footer(start, at, 0))[:-_CHECKSUM]
        checksum = zlib.crc32(footer, zlib.crc32(summary))
        self._hold(summary + _encoded(Footer(start, at, checksum)) + MAGIC)
        self.commit()

    def has_room(self, more: int = 0, times: int = 1) -> bool:
        """Whether the disk has room for what is held back, more bytes, and some time after it."""
        system = os.fstatvfs(self._descriptor)
        some_time = min(_ROOM, system.f_blocks * system.f_frsize // _SHARE)
        needed = self.size - self.committed + more + times * some_time
        return system.f_bavail * system.f_frsize >= needed

    def sync(self) -> None:
        """Force to the disk what was committed, if the file is open; in any thread.

        Raises:
            FileNotFoundError: When the file was removed.
        """
        if self._descriptor < 0:
            return
        try:
            os.fdatasync(self._descriptor)
        except OSError as error:
            if error.errno not in {errno.EINVAL, errno.EROFS}:  # a file that cannot be synced
                raise
        if os.fstat(self._descriptor).st_nlink == 0:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self.path))
        if not self._has_name:
            sync_folder(self.path.parent)
            self._has_name = True

    def complete(self) -> None:
        """Make the file durable, give it its final name and close it; in any thread."""
        try:
            self.sync()
            self.path.rename(self._final_path)
            self.path = self._final_path
        finally:
            self._close()
        sync_folder(self.path.parent)

    def abandon(self) -> None:
        """Cut the file after the last commit and close it. Never raises."""
        self._held, self._chunk = [], bytearray()
        self.size = self.committed
        with contextlib.suppress(OSError):
            self._cut()
        with contextlib.suppress(OSError):
            self._close()

    def _end_chunk(self) -> None:
        if not self._chunk:
            return
        compressed = self._compressor.compress(self._chunk)
        size, start = len(self._chunk), self.size
        length = _CHUNK.size + len(compressed)
        head = _CHUNK.pack(
            Opcode.CHUNK,
            length - 9,
            self._chunk_begin,
            self._chunk_end,
            size,
            zlib.crc32(self._chunk),
            len(_ZSTD),
            _ZSTD,
            len(compressed),
        )
        pieces: list[bytes | bytearray] = [head, compressed]
        offsets, counts = dict[int, int](), dict[int, int]()
        at = start + length
        for channel, entries in self._entries.items():
            offsets[channel], counts[channel] = at, len(entries) // ENTRY.size
            head = INDEX.pack(
                Opcode.MESSAGE_INDEX, INDEX.size - 9 + len(entries), channel, len(entries)
            )
            pieces += (head, entries)
            at += len(head) + len(entries)
        self._held += pieces
        self.size = at
        index = ChunkIndex(
            message_start_time=self._chunk_begin,
            message_end_time=self._chunk_end,
            chunk_start_offset=start,
            chunk_length=length,
            message_index_offsets=offsets,
            message_index_length=at - start - length,
            compression=_ZSTD.decode(),
            compressed_size=len(compressed),
            uncompressed_size=size,
        )
        self._note_chunk(index, counts)
        self._chunk, self._entries = bytearray(), {}

    def _note_chunk(self, index: ChunkIndex, counts: Mapping[int, int]) -> None:
        known = self.statistics
        begin = index.message_start_time
        known.message_start_time = (
            min(known.message_start_time, begin) if known.chunk_count else begin
        )
        known.message_end_time = max(known.message_end_time, index.message_end_time)
        known.chunk_count += 1
        known.message_count += sum(counts.values())
        for channel, count in counts.items():
            known.channel_message_counts[channel] += count
        # Encoded, it takes a tenth of the memory.
        self._summary[Opcode.CHUNK_INDEX].append(_encoded(index))

    def _cut(self) -> None:
        if self._descriptor >= 0:
            os.ftruncate(self._descriptor, self.committed)

    def _close(self) -> None:
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)  # and its lock ends

    def __del__(self) -> None:
        self._close()


def _encoded(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def sync_folder(folder: Path) -> None:
    """Make names in a folder durable, where the file system can."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    except OSError:
        # Some file systems (FUSE, network) refuse this for a folder; the file itself is synced.
        pass
    finally:
        os.close(descriptor)


def _text(text: str) -> str:
    """Text as MCAP can hold it: a file name that is not Unicode is written with escapes."""
    return text_bytes(text).decode()
