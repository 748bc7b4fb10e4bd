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
from collections import Counter
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema
from msgspec import Struct

from play_launch import UserError
from play_launch.postmortem.mcap_records import (
    LATEST,
    MESSAGE,
    MESSAGE_KIND,
    RECORD,
    BrokenError,
    Runs,
    check_end,
    end_of_indexes,
    is_too_long,
    read_attachment,
    read_chunk,
    read_content,
    read_record,
    refuse,
)
from play_launch.recording.clock import CLOCK_METADATA
from play_launch.recording.folder import (
    ACTIVE_SUFFIX,
    BAG_NAME,
    MAGIC,
    PartFile,
    open_bag,
    part_path,
    parts_of,
)
from play_launch.recording.topics import KEY, KIND, MACHINES_METADATA, PART_METADATA, REPEATED

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterator
    from pathlib import Path

    from play_launch.supervisor.events import RunEvent

_FOR_APPLICATIONS: Final = 0x80
"""From here on the meaning of records is up to a program."""
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
    sequence: int = 0
    ahead_ns: int | None = 0
    """By how much the system clock was ahead of the session's, as publish time and stamps are.

    None in a merged recording, whose stamps are of several clocks.
    """


Take: TypeAlias = "Callable[[Message], RunEvent | None]"
"""What is called with each message of a topic; it gives the event that it read."""
TakeOf: TypeAlias = "Callable[[RecordedTopic], Take | Runs | None]"


class ChannelInfo(Struct):
    """A channel as the file describes it."""

    topic: RecordedTopic
    channel: Channel
    schema: Schema | None
    take: Take | None = None
    runs: Runs | None = None
    """Without either, its messages are only counted."""
    count: int = 0
    """Messages so far."""


@dataclass(slots=True)
class BagReader:
    """One pass, by `records` or `messages`; the rest is known as far as that has come.

    What one of several files repeats from that before it is skipped when that was read.
    """

    path: Path
    """The file, or the folder with the files."""
    attachments: dict[str, Attachment] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
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
    offset: int = 0
    """Where in that file the record begins that is being read."""
    _take_of: TakeOf = field(default=lambda _: None)
    _schemas: dict[int, Schema] = field(default_factory=dict)
    _counted: list[ChannelInfo] = field(default_factory=list)
    """Those of all files."""
    _described: set[bytes] = field(default_factory=set)
    """Records of schemas and channels."""
    _before: int = -1
    """Number of the file that was read before this one."""
    _has_chunks: bool = False
    _skips_repeated: bool = False
    _noted: Damage | None = None
    _unlisted: int = 0

    @property
    def counts(self) -> dict[RecordedTopic, int]:
        """Messages of each topic, the unwanted ones included."""
        counts: Counter[RecordedTopic] = Counter()
        for channel in self._counted:
            counts[channel.topic] += channel.count
        return counts

    @property
    def ahead_ns(self) -> int:
        """By how much the system clock is ahead of the session's, as it was set since the start."""
        return _number(self.metadata.get(CLOCK_METADATA, {}).get("ahead_ns", ""))

    @property
    def removed_files(self) -> int:
        """How many files were removed at the beginning (`record.keep.size`)."""
        return max(0, _number(self.metadata.get(PART_METADATA, {}).get("first", "")))

    @property
    def notes(self) -> Iterator[str]:
        """What is to be reported of a recording beside damages."""
        is_whole = len(self.files) > 1 or MACHINES_METADATA in self.metadata
        if self.removed_files and is_whole:
            yield f"{self.removed_files:,} files of its beginning were removed (record.keep.size)"
        if abs(days := self.ahead_ns / _DAY) >= 1:
            way = "forward" if days > 0 else "back"
            yield f"the clock was set {way} by {abs(days):,.1f} days; times do not follow that"

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
        found: list[Message] = []
        for _ in self.records(
            lambda topic: found.append if wanted is None or topic.name in wanted else None
        ):
            yield from found
            found.clear()

    def records(self, take_of: TakeOf) -> Iterator[None]:
        """Read record by record, and call what ``take_of`` gives for the topic of a message.

        Raises:
            NotARecordingError: At once, for another kind of file.
        """
        parts = _parts(self.path)
        self.files = tuple(part.path.name for part in parts)
        self._take_of = take_of
        are_complete, unreadable = [], []
        for part in parts:
            self.file = part.path.name if len(parts) > 1 else ""
            self.is_complete = self._has_chunks = self._skips_repeated = False
            self.channels, self._schemas, self._described = {}, {}, set()
            try:
                yield from self._records_of(part.path)
                self._before = part.number
            except NotARecordingError as error:
                unreadable.append(error)
                self.offset = 0
                self.damaged(str(error).removeprefix(f"{part.path}: "))
            are_complete.append(self.is_complete)
        if len(unreadable) == len(parts):
            raise unreadable[0]
        self.is_complete = all(are_complete)
        if len(parts) > 1:
            self._note_missing(parts)

    def _note_missing(self, parts: list[PartFile]) -> None:
        last = parts[-1].number
        first = min(self.removed_files, last)
        there = {part.number for part in parts if part.number >= first}
        left = last + 1 - first - len(there)
        # A name can hold any number.
        missing = (each for each in range(first, last) if each not in there)
        for number in islice(missing, _LISTED + 1):
            name = part_path(self.path / BAG_NAME, number).name
            left -= 1
            self.note(Damage(0, "the file is missing", name))
        if left:
            self.note(Damage(0, "files are missing", parts[-1].path.name), places=left)

    def _records_of(self, path: Path) -> Iterator[None]:
        try:
            file = open_bag(path)
            size, magic = os.fstat(file.fileno()).st_size, file.read(len(MAGIC))
        except OSError as error:
            unfinished = path.with_name(f"{path.name}{ACTIVE_SUFFIX}")
            hint = f"; there is {unfinished.name}, unfinished" if unfinished.exists() else ""
            raise NotARecordingError(f"{path}: {error.strerror}{hint}") from error
        with file:
            self.size += size
            if magic != MAGIC:
                raise NotARecordingError(f"{path}: it is not an MCAP file")
            at = len(MAGIC)
            while at < size and not self.is_complete:
                self.offset = at
                try:
                    file.seek(at)
                    kind, length = RECORD.unpack(file.read(RECORD.size))
                except (OSError, struct.error) as error:
                    reason = getattr(error, "strerror", None) or "the file ends within a record"
                    self.damaged(reason)
                    return
                end = at + RECORD.size + length
                if end > size or is_too_long(kind, length) or kind == length == 0:
                    reason = f"the file ends within a record, or its length ({length} bytes) is "
                    self.damaged(f"{reason}wrong; {size - at:,} bytes are not read")
                    return
                try:
                    if kind == Opcode.MESSAGE_INDEX:
                        end = end_of_indexes(file, at)
                    elif kind in {Opcode.DATA_END, Opcode.FOOTER}:
                        check_end(
                            file, size, end if kind == Opcode.DATA_END else at, self._described
                        )
                        self.is_complete = True
                    elif kind != Opcode.HEADER or at > len(MAGIC):
                        self._record(kind, read_content(file, kind, length))
                except (BrokenError, OSError) as error:
                    # A sector that cannot be read costs the record that it is in.
                    self.damaged(getattr(error, "strerror", None) or str(error))
                    if kind in {Opcode.DATA_END, Opcode.FOOTER}:
                        return
                finally:
                    yield
                at = end

    def _record(self, kind: int, content: bytes) -> None:
        match kind:
            case Opcode.CHUNK:
                self._has_chunks = True
                self._data(read_chunk(content))
            case Opcode.MESSAGE if not self._has_chunks:  # no writer does both
                self._data(RECORD.pack(kind, len(content)) + content)
            case Opcode.SCHEMA | Opcode.CHANNEL:
                self._describe(kind, content)
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

    def _data(self, data: bytes) -> None:
        """Read the records of a chunk, and pass on the messages that are wanted."""
        size = len(data)
        begin = 0
        earliest = self.begin or sys.maxsize
        ahead_ns = None if MACHINES_METADATA in self.metadata else self.ahead_ns
        unpack, head, channels = MESSAGE.unpack_from, MESSAGE.size, self.channels
        skips_repeated = self._skips_repeated
        # An hour of a large system has a million messages: this looks at each once.
        while begin < size:
            if size - begin < head or data[begin] != MESSAGE_KIND:
                begin = self._other(data, begin)
                continue
            _, length, number, sequence, log_time, publish_time = unpack(data, begin)
            end = begin + RECORD.size + length
            if end > size:
                raise BrokenError("a record reaches beyond its chunk")
            if end < begin + head:
                raise BrokenError("a message is too short")
            if number not in channels:
                reason = f"a message belongs to channel {number}, which nothing describes"
                raise BrokenError(reason)
            channel = channels[number]
            data_at = begin + head
            begin = end
            if skips_repeated and sequence == REPEATED:
                continue
            if log_time > self.end:
                log_time = self.end = log_time if log_time <= LATEST else self.end
            if log_time < earliest:
                self.begin = earliest = log_time
            if channel.runs is not None:
                begin, latest = channel.runs.take(data, data_at - head, channels)
                self.end = max(self.end, latest)
                continue
            channel.count += 1
            if (take := channel.take) is not None:
                take(
                    Message(
                        channel.topic,
                        log_time,
                        publish_time,
                        data[data_at:end],
                        number,
                        sequence,
                        ahead_ns,
                    )
                )

    def _other(self, data: bytes, begin: int) -> int:
        """Read a record of a chunk that is no whole message; return where the next one begins."""
        if len(data) - begin < RECORD.size:
            raise BrokenError("a chunk ends within a record")
        kind, length = RECORD.unpack_from(data, begin)
        begin += RECORD.size
        if length > len(data) - begin:
            raise BrokenError("a record reaches beyond its chunk")
        if kind == MESSAGE_KIND:
            raise BrokenError("a message is too short")
        self._describe(kind, data[begin : begin + length])
        return int(begin + length)

    def _describe(self, kind: int, content: bytes) -> None:
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
                made = ChannelInfo(topic, channel, described)
                take = self._take_of(topic)
                if isinstance(take, Runs):
                    made.runs = take
                else:
                    made.take = take
                self.channels[channel.id] = made
                self._counted.append(made)
                self._described.add(content)
            case _ if kind < _FOR_APPLICATIONS:
                # A gigabyte of zeros, which are small in the file, would be as many records.
                refuse(kind)

    def damaged(self, reason: str) -> None:
        """Note that something in the record that is being read cannot be read."""
        self.note(Damage(self.offset, reason, self.file))


def _parts(path: Path) -> list[PartFile]:
    try:
        parts = parts_of(path) if path.is_dir() else [PartFile(path, 0)]
    except OSError as error:
        raise NotARecordingError(f"{path}: {error.strerror}") from error
    if not parts:
        raise NotARecordingError(f"{path}: no {BAG_NAME} is in this folder")
    return parts


def _number(text: str) -> int:
    digits = text.removeprefix("-")
    return int(text) if digits.isascii() and digits.isdecimal() and len(digits) < 20 else 0
