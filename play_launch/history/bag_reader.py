"""An MCAP file from its beginning to its end, or to where it cannot be read any more.

The readers of the package ``mcap`` end with whatever exception damage leads to, and believe every
length that they find. A recording is wanted above all after something went wrong, so this one keeps
what can be read: a broken chunk is left out, a record that reaches beyond the file ends it, and
each such place is remembered. The index at the end is not used: a file may not have one.
"""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO, TYPE_CHECKING, Any, Final, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterator
    from pathlib import Path

_MAGIC: Final = b"\x89MCAP0\r\n"
_RECORD: Final = struct.Struct("<BQ")
"""Kind and length of the content."""
_MESSAGE: Final = struct.Struct("<HIQQ")
"""Channel, sequence number, log time, publish time; the data follows."""
_LARGEST_CHUNK: Final = 1 << 30
"""Bytes; no writer makes larger ones, so a larger number is damage."""


class NotARecordingError(Exception):
    """The file cannot be read, or holds something else; the text names it and says why."""


class Damage(NamedTuple):
    """A place of the file that cannot be read."""

    offset: int
    """In bytes, of the record."""
    reason: str

    def __str__(self) -> str:
        return f"byte {self.offset}: {self.reason}"


class Topic(NamedTuple):
    """A channel of the file."""

    name: str
    type_name: str
    encoding: str


class Message(NamedTuple):
    """One message; times are nanoseconds since the epoch."""

    topic: Topic
    log_time: int
    publish_time: int
    data: bytes
    channel: int
    """Its number in the file."""
    offset: int
    """In the file, in bytes: of its record, or of the chunk that holds it."""


class Description(NamedTuple):
    """What a file says about a channel, as it stands there."""

    topic: Topic
    channel: Channel
    schema: Schema | None
    is_wanted: bool


@dataclass(slots=True)
class BagReader:
    """One pass over a file: iterate over `messages`; the rest is known as far as that has come."""

    path: Path
    attachments: dict[str, Attachment] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    counts: dict[Topic, int] = field(default_factory=dict)
    """Messages of each topic, the unwanted ones included."""
    damages: list[Damage] = field(default_factory=list)
    size: int = 0
    """Bytes."""
    is_complete: bool = False
    """Whether it was closed in order: its last record is there."""
    begin: int = 0
    end: int = 0
    """Log times of the earliest and the latest message; 0 without any."""
    channels: dict[int, Description] = field(default_factory=dict)
    _schemas: dict[int, Schema] = field(default_factory=dict)

    def messages(self, wanted: Container[str] | None = None) -> Iterator[Message]:
        """Give the messages of these topics (None: all) in the order of the file.

        Raises:
            NotARecordingError: At once, when it is none.
        """
        try:
            with self.path.open("rb") as file:
                self.size = os.fstat(file.fileno()).st_size
                if file.read(len(_MAGIC)) != _MAGIC:
                    raise NotARecordingError(f"{self.path}: it is not an MCAP file")
                yield from self._records(file, wanted)
        except OSError as error:
            raise NotARecordingError(f"{self.path}: {error.strerror}") from error

    def _records(self, file: IO[bytes], wanted: Container[str] | None) -> Iterator[Message]:
        at = len(_MAGIC)
        while at < self.size:
            head = file.read(_RECORD.size)
            if len(head) < _RECORD.size:
                self._damaged(at, "the file ends within a record")
                return
            kind, length = _RECORD.unpack(head)
            end = at + _RECORD.size + length
            if end > self.size or (kind == Opcode.CHUNK and length > _LARGEST_CHUNK):
                reason = f"the file ends within a record, or its length ({length} bytes) is wrong"
                self._damaged(at, reason)
                return
            if kind in {Opcode.DATA_END, Opcode.FOOTER}:
                # What follows repeats what was read.
                self.is_complete = self._ends_in_order(file)
                if not self.is_complete:
                    self._damaged(at, "the summary at its end is not whole")
                return
            try:
                match kind:
                    case Opcode.CHUNK:
                        yield from self._chunk(file.read(length), at, wanted)
                    case Opcode.SCHEMA | Opcode.CHANNEL | Opcode.MESSAGE:
                        message = self._record(kind, file.read(length), at, wanted)
                        if message is not None:
                            yield message
                    case Opcode.ATTACHMENT:
                        attachment = _read(Attachment.read, file.read(length))
                        self.attachments[attachment.name] = attachment
                    case Opcode.METADATA:
                        metadata = _read(Metadata.read, file.read(length))
                        self.metadata[metadata.name] = metadata.metadata
                    case _:
                        file.seek(end)
            except _BrokenError as error:
                self._damaged(at, str(error))
            at = end

    def _chunk(
        self, content: bytes, offset: int, wanted: Container[str] | None
    ) -> Iterator[Message]:
        data = _decompressed(_read(Chunk.read, content))
        at = 0
        while at < len(data):
            if len(data) - at < _RECORD.size:
                raise _BrokenError("a chunk ends within a record")
            kind, length = _RECORD.unpack_from(data, at)
            at += _RECORD.size
            if length > len(data) - at:
                raise _BrokenError("a record reaches beyond its chunk")
            message = self._record(kind, data[at : at + length], offset, wanted)
            if message is not None:
                yield message
            at += length

    def _record(
        self, kind: int, content: bytes, offset: int, wanted: Container[str] | None
    ) -> Message | None:
        match kind:
            case Opcode.MESSAGE:
                return self._message(content, offset)
            case Opcode.SCHEMA:
                schema = _read(Schema.read, content)
                self._schemas[schema.id] = schema
            case Opcode.CHANNEL:
                channel = _read(Channel.read, content)
                described = self._schemas.get(channel.schema_id)
                type_name = described.name if described else ""
                topic = Topic(channel.topic, type_name, channel.message_encoding)
                is_wanted = wanted is None or topic.name in wanted
                self.channels[channel.id] = Description(topic, channel, described, is_wanted)
                self.counts.setdefault(topic, 0)
        return None

    def _message(self, content: bytes, offset: int) -> Message | None:
        if len(content) < _MESSAGE.size:
            raise _BrokenError("a message is too short")
        number, _, log_time, publish_time = _MESSAGE.unpack_from(content)
        channel = self.channels.get(number)
        if channel is None:
            raise _BrokenError(f"a message belongs to channel {number}, which nothing describes")
        self.counts[channel.topic] += 1
        self.begin = min(self.begin, log_time) if self.begin else log_time
        self.end = max(self.end, log_time)
        if not channel.is_wanted:
            return None
        return Message(
            channel.topic, log_time, publish_time, content[_MESSAGE.size :], number, offset
        )

    def _ends_in_order(self, file: IO[bytes]) -> bool:
        file.seek(-len(_MAGIC), os.SEEK_END)
        return file.read() == _MAGIC

    def _damaged(self, at: int, reason: str) -> None:
        self.damages.append(Damage(at, reason))


class _BrokenError(Exception):
    """A record is not what it should be."""


def _read(read: Callable[[Any], Any], content: bytes) -> Any:
    stream = ReadDataStream(BytesIO(content))
    try:
        return read(stream)
    except Exception as error:
        raise _BrokenError(f"a record cannot be read ({type(error).__name__}: {error})") from error


def _decompressed(chunk: Chunk) -> bytes:
    if chunk.uncompressed_size > _LARGEST_CHUNK:
        raise _BrokenError(f"a chunk says that it has {chunk.uncompressed_size} bytes")
    decompress = _DECOMPRESS.get(chunk.compression)
    if decompress is None:
        raise _BrokenError(f"a chunk is compressed by {chunk.compression!r}, which is not known")
    try:
        data = decompress(chunk)
    except Exception as error:  # the libraries' own types
        raise _BrokenError(f"a chunk cannot be decompressed ({error})") from error
    if chunk.uncompressed_crc not in {0, zlib.crc32(data)}:
        raise _BrokenError("the checksum of a chunk is wrong")
    return data


def _zstd(chunk: Chunk) -> bytes:
    import zstandard  # noqa: PLC0415 - only what a file needs

    size = max(1, chunk.uncompressed_size)
    return zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=size)


def _lz4(chunk: Chunk) -> bytes:
    from lz4 import frame  # type: ignore[import-untyped]  # noqa: PLC0415

    data: bytes = frame.decompress(chunk.data)
    return data


_DECOMPRESS: Final[dict[str, Callable[[Chunk], bytes]]] = {
    "": lambda chunk: chunk.data,
    "zstd": _zstd,
    "lz4": _lz4,
}
