"""A recording from its beginning to its end, or to where it cannot be read.

It is one MCAP file, or a folder with several that follow each other.

The readers of the package ``mcap`` end with whatever exception damage leads to. A recording is
wanted above all after something went wrong, so this one skips records that are broken and notes
each. It stops behind a record whose length is wrong: ``mcap recover`` repairs such files. The index
at the end is not used: a file may not have one.
"""

from __future__ import annotations

import os
import struct
import sys
from dataclasses import dataclass, field
from itertools import islice
from typing import IO, TYPE_CHECKING, Final, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema
from msgspec import Struct

from play_launch import UserError
from play_launch.postmortem.records import (
    INDEX,
    BrokenError,
    check_end,
    is_too_long,
    is_wrong_index,
    read_attachment,
    read_chunk,
    read_content,
    read_record,
    refuse,
)
from play_launch.recording.bag import PART_METADATA, REPEATED
from play_launch.recording.clock import CLOCK_METADATA
from play_launch.recording.folder import BAG_NAME, PartFile, open_bag, part_path, parts_of
from play_launch.recording.mcap_file import MAGIC
from play_launch.recording.topics import KEY, KIND

if TYPE_CHECKING:
    from collections.abc import Container, Iterator
    from pathlib import Path

_RECORD: Final = struct.Struct("<BQ")
"""Kind and length of the content."""
_MESSAGE: Final = struct.Struct("<HIQQ")
"""Channel, sequence number, log time, publish time; the data follows."""
_IN_CHUNK: Final = struct.Struct("<BQHIQQ")
"""A message with what precedes each record."""
_MESSAGE_KIND: Final = int(Opcode.MESSAGE)
_FOR_APPLICATIONS: Final = 0x80
"""From here on the meaning of records is up to a program."""
_LATEST: Final = (1 << 63) - 1
"""Nanoseconds since the epoch: later times are damage."""
_DAY: Final = 24 * 3600 * 1_000_000_000
_LISTED: Final = 100
"""Damages that are listed one by one."""


class NotARecordingError(UserError):
    """The file cannot be read, or holds something else; the text has its path and the cause."""


class Damage(NamedTuple):
    """A place of the file that cannot be read."""

    offset: int
    """In bytes, of the record."""
    reason: str
    file: str = ""
    """Its name, where the recording has several."""

    def __str__(self) -> str:
        place = f"byte {self.offset}: {self.reason}"
        return f"{self.file}: {place}" if self.file else place


class RecordedTopic(Struct, frozen=True, order=True, cache_hash=True):
    """A channel of the file."""

    name: str
    type_name: str
    encoding: str
    kind: str = ""
    """What its messages are about, where that is one thing: node, container, process."""
    key: str = ""
    """Of that, as in the changes of state."""


class Message(Struct, frozen=True, gc=False):
    """One message; times are nanoseconds since the epoch."""

    topic: RecordedTopic
    log_time: int
    publish_time: int
    data: bytes
    channel: int
    """Its number in the file."""
    offset: int
    """In the file, in bytes: of its record, or of the chunk that holds it."""
    sequence: int = 0
    ahead_ns: int = 0
    """By how much the system clock was ahead of the session's, as publish time and stamps are."""


class ChannelInfo(NamedTuple):
    """A channel as the file describes it."""

    topic: RecordedTopic
    channel: Channel
    schema: Schema | None
    is_wanted: bool


@dataclass(slots=True)
class BagReader:
    """One pass: iterate over `messages`; the rest is known as far as that has come.

    What one of several files repeats from that before it is skipped when that was read.
    """

    path: Path
    """The file, or the folder with the files."""
    attachments: dict[str, Attachment] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    counts: dict[RecordedTopic, int] = field(default_factory=dict)
    """Messages of each topic, the unwanted ones included."""
    damages: list[Damage] = field(default_factory=list)
    """The first ones; of more than can be listed the last stands for the rest."""
    size: int = 0
    """Bytes."""
    is_complete: bool = False
    """Whether it was closed in order: its last record is there."""
    begin: int = 0
    end: int = 0
    """Log times of the earliest and the latest message; 0 without any."""
    channels: dict[int, ChannelInfo] = field(default_factory=dict)
    """Those of the file that is being read."""
    files: tuple[str, ...] = ()
    """The names of all."""
    file: str = ""
    """The name of that file, where the recording has several."""
    _schemas: dict[int, Schema] = field(default_factory=dict)
    _described: set[bytes] = field(default_factory=set)
    """Records of schemas and channels."""
    _before: int = -1
    """Number of the file that was read before this one."""
    _has_chunks: bool = False
    _skips_repeated: bool = False
    _noted: Damage | None = None
    _unlisted: int = 0

    @property
    def ahead_ns(self) -> int:
        """By how much the system clock is ahead of the session's, as it was set since the start."""
        return _number(self.metadata.get(CLOCK_METADATA, {}).get("ahead_ns", ""))

    @property
    def clock_note(self) -> str:
        """What is to be reported about times, if anything."""
        if abs(self.ahead_ns) < _DAY:
            return ""
        way = "forward" if self.ahead_ns > 0 else "back"
        return (
            f"the clock was set {way} by {abs(self.ahead_ns) / _DAY:,.1f} days while this was "
            "recorded; times after the start are given as if it had not been"
        )

    def note(self, damage: Damage, *, places: int = 1) -> None:
        """Note a place that cannot be read, or so many; it may be noted twice in a row."""
        if damage == self._noted:
            return
        self._noted = damage
        if len(self.damages) < _LISTED:
            self.damages.append(damage)
            return
        self._unlisted += places
        if len(self.damages) == _LISTED:
            self.damages.append(damage)
        if self._unlisted > 1:
            reason = f"from here on {self._unlisted:,} places cannot be read"
            self.damages[-1] = self.damages[-1]._replace(reason=reason)

    def messages(self, wanted: Container[str] | None = None) -> Iterator[Message]:
        """Yield the messages of these topics (None: all) in the order of the file.

        Raises:
            NotARecordingError: At once, for another kind of file.
        """
        parts = _parts(self.path)
        self.files = tuple(part.path.name for part in parts)
        are_complete, unreadable = [], []
        for part in parts:
            self.file = part.path.name if len(parts) > 1 else ""
            self.is_complete = self._has_chunks = self._skips_repeated = False
            self.channels, self._schemas, self._described = {}, {}, set()
            try:
                for found in self._file_messages(part.path, wanted):
                    yield from found
                self._before = part.number
            except NotARecordingError as error:
                unreadable.append(error)
                self._damaged(0, str(error).removeprefix(f"{part.path}: "))
            are_complete.append(self.is_complete)
        if len(unreadable) == len(parts):
            raise unreadable[0]
        self.is_complete = all(are_complete)
        if len(parts) > 1:
            self._note_missing(parts)

    def _file_messages(self, path: Path, wanted: Container[str] | None) -> Iterator[list[Message]]:
        """Yield those of a file, chunk by chunk."""
        try:
            file = open_bag(path)
        except OSError as error:
            raise NotARecordingError(f"{path}: {error.strerror}") from error
        with file:
            try:
                size = os.fstat(file.fileno()).st_size
                magic = file.read(len(MAGIC))
            except OSError as error:
                raise NotARecordingError(f"{path}: {error.strerror}") from error
            self.size += size
            if magic != MAGIC:
                raise NotARecordingError(f"{path}: it is not an MCAP file")
            yield from self._records(file, size, wanted)

    def _note_missing(self, parts: list[PartFile]) -> None:
        there, last = {part.number for part in parts}, parts[-1].number
        left = last + 1 - len(there)
        # A name can hold any number.
        for number in islice((each for each in range(last) if each not in there), _LISTED + 1):
            name = part_path(self.path / BAG_NAME, number).name
            left -= 1
            self.note(Damage(0, "the file is missing", name))
        if left:
            self.note(Damage(0, "files are missing", parts[-1].path.name), places=left)

    def _records(
        self, file: IO[bytes], size: int, wanted: Container[str] | None
    ) -> Iterator[list[Message]]:
        at = len(MAGIC)
        while at < size:
            try:
                file.seek(at)
                head = file.read(_RECORD.size + INDEX.size)
                kind, length = _RECORD.unpack_from(head)
            except (OSError, struct.error) as error:
                reason = getattr(error, "strerror", None) or "the file ends within a record"
                self._damaged(at, reason)
                return
            end = at + _RECORD.size + length
            if end > size or is_too_long(kind, length) or kind == length == 0:
                reason = f"the file ends within a record, or its length ({length} bytes) is wrong"
                self._damaged(at, f"{reason}; {size - at:,} bytes are not read")
                return
            if kind == Opcode.MESSAGE_INDEX:  # most records by far, one for each topic of a chunk
                if is_wrong_index(head[_RECORD.size :], length):
                    self._damaged(at, "an index has a wrong length, or is something else")
                at = end
                continue
            found: list[Message] = []
            try:
                file.seek(at + _RECORD.size)
                if kind in {Opcode.DATA_END, Opcode.FOOTER}:
                    end_of_data = end if kind == Opcode.DATA_END else at
                    check_end(file, size, end_of_data, self._described)
                    self.is_complete = True
                    return
                if kind != Opcode.HEADER or at > len(MAGIC):
                    self._record(kind, read_content(file, kind, length), at, wanted, found)
            except (BrokenError, OSError) as error:
                # A sector that cannot be read costs the record that it is in.
                self._damaged(at, getattr(error, "strerror", None) or str(error))
                if kind in {Opcode.DATA_END, Opcode.FOOTER}:
                    return
            finally:
                yield found
            at = end

    def _record(
        self,
        kind: int,
        content: bytes,
        at: int,
        wanted: Container[str] | None,
        found: list[Message],
    ) -> None:
        match kind:
            case Opcode.CHUNK:
                self._has_chunks = True
                self._data(read_chunk(content), at, wanted, found)
            case Opcode.MESSAGE if not self._has_chunks:  # no writer does both
                self._data(_RECORD.pack(kind, len(content)) + content, at, wanted, found)
            case Opcode.SCHEMA | Opcode.CHANNEL:
                self._describe(kind, content, wanted)
            case Opcode.ATTACHMENT:
                attachment, is_right = read_attachment(content)
                self.attachments[attachment.name] = attachment
                if not is_right:
                    # Better than none: a configuration with a wrong letter is still readable.
                    raise BrokenError(f"the checksum of the attachment {attachment.name} is wrong")
            case Opcode.METADATA:
                metadata = read_record(Metadata.read, content)
                self.metadata[metadata.name] = metadata.metadata
                if metadata.name == PART_METADATA:
                    number = _number(metadata.metadata.get("number", ""))
                    self._skips_repeated = number == self._before + 1 > 0
            case _:
                refuse(kind)

    def _data(
        self, data: bytes, offset: int, wanted: Container[str] | None, found: list[Message]
    ) -> None:
        """Read the records of a chunk; add wanted messages to ``found``."""
        size = len(data)
        begin = end = 0
        counts: dict[int, int] = {}
        earliest, latest, ahead_ns = self.begin or sys.maxsize, self.end, self.ahead_ns
        unpack, head, channels = _IN_CHUNK.unpack_from, _IN_CHUNK.size, self.channels
        # An hour of a large system has a million messages: this looks at each once.
        try:
            while begin < size:
                if size - begin < head or data[begin] != _MESSAGE_KIND:
                    begin = self._other(data, begin, wanted)
                    continue
                _, length, number, sequence, log_time, publish_time = unpack(data, begin)
                end = begin + _RECORD.size + length
                if end > size:
                    raise BrokenError("a record reaches beyond its chunk")
                if length < _MESSAGE.size:
                    raise BrokenError("a message is too short")
                channel = channels.get(number)
                if channel is None:
                    reason = f"a message belongs to channel {number}, which nothing describes"
                    raise BrokenError(reason)
                data_at = begin + head
                begin = end
                if sequence == REPEATED and self._skips_repeated:
                    continue
                counts[number] = counts.get(number, 0) + 1
                if log_time > _LATEST:
                    log_time = latest
                if log_time > latest:  # noqa: PLR1730 - several times as fast as max()
                    latest = log_time
                if log_time < earliest:  # noqa: PLR1730 - and min()
                    earliest = log_time
                if channel.is_wanted:
                    found.append(
                        Message(
                            channel.topic,
                            log_time,
                            publish_time,
                            data[data_at:end],
                            number,
                            offset,
                            sequence,
                            ahead_ns,
                        )
                    )
        finally:
            for number, count in counts.items():
                self.counts[channels[number].topic] += count
            if counts:
                self.begin, self.end = earliest, latest

    def _other(self, data: bytes, begin: int, wanted: Container[str] | None) -> int:
        """Read a record of a chunk that is no whole message; return where the next one begins."""
        if len(data) - begin < _RECORD.size:
            raise BrokenError("a chunk ends within a record")
        kind, length = _RECORD.unpack_from(data, begin)
        begin += _RECORD.size
        if length > len(data) - begin:
            raise BrokenError("a record reaches beyond its chunk")
        if kind == _MESSAGE_KIND:
            raise BrokenError("a message is too short")
        self._describe(kind, data[begin : begin + length], wanted)
        return int(begin + length)

    def _describe(self, kind: int, content: bytes, wanted: Container[str] | None) -> None:
        match kind:
            case Opcode.SCHEMA:
                schema = read_record(Schema.read, content)
                self._schemas[schema.id] = schema
                self._described.add(content)
            case Opcode.CHANNEL:
                channel = read_record(Channel.read, content)
                described = self._schemas.get(channel.schema_id)
                topic = RecordedTopic(
                    channel.topic,
                    described.name if described else "",
                    channel.message_encoding,
                    channel.metadata.get(KIND, ""),
                    channel.metadata.get(KEY, ""),
                )
                is_wanted = wanted is None or topic.name in wanted
                self.channels[channel.id] = ChannelInfo(topic, channel, described, is_wanted)
                self.counts.setdefault(topic, 0)
                self._described.add(content)
            case _ if kind < _FOR_APPLICATIONS:
                # A gigabyte of zeros, which are small in the file, would be as many records.
                refuse(kind)

    def _damaged(self, at: int, reason: str) -> None:
        self.note(Damage(at, reason, self.file))


def _parts(path: Path) -> list[PartFile]:
    if not path.is_dir():
        return [PartFile(path, 0)]
    try:
        parts = parts_of(path)
    except OSError as error:
        raise NotARecordingError(f"{path}: {error.strerror}") from error
    if not parts:
        raise NotARecordingError(f"{path}: no {BAG_NAME} is in this folder")
    return parts


def _number(text: str) -> int:
    digits = text.removeprefix("-")
    return int(text) if digits.isascii() and digits.isdecimal() and len(digits) < 20 else 0
