"""Records of an MCAP file, accepted only as far as they fit together."""

from __future__ import annotations

import functools
import re
import struct
import zlib
from collections.abc import Callable, Mapping  # noqa: TC003 - fields of a Struct
from io import BytesIO
from itertools import takewhile
from typing import IO, TYPE_CHECKING, Any, Final, NamedTuple, NoReturn

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment
from msgspec import Struct

from play_launch.recording.folder import MAGIC

if TYPE_CHECKING:
    from collections.abc import Collection

    import zstandard

    from play_launch.postmortem.bag_reader import ChannelInfo

_LIMITS: Final[dict[int, int]] = {
    Opcode.CHUNK: 1 << 30,
    Opcode.ATTACHMENT: 1 << 30,
    Opcode.MESSAGE: 1 << 28,
    Opcode.MESSAGE_INDEX: 1 << 28,
}
"""Bytes of a record by its kind; no writer makes longer ones."""
_LIMIT: Final = 1 << 24
"""Bytes of a record of another kind: it describes something."""
_HEAD: Final = 1 << 14
"""Bytes of a record in which its length stands."""
_BLOCK: Final = 1 << 20
RECORD: Final = struct.Struct("<BQ")
"""Kind and length of the content."""
_INDEX: Final = struct.Struct("<BQHI")
"""A message index: channel and length of the entries, which follow."""
_ENTRY: Final = 16
"""Log time and offset of a message."""
MESSAGE: Final = struct.Struct("<BQHIQQ")
"""Kind, length, channel, sequence number, log time, publish time; the data follows."""
MESSAGE_KIND: Final = int(Opcode.MESSAGE)
NUMBER_AT: Final = RECORD.size
"""Where the number of the channel stands in a message."""
_MOST_SEQUENCES: Final = 1000
LATEST: Final = (1 << 63) - 1
"""Nanoseconds since the epoch: later times are damage."""
_WINDOW: Final = 1 << 13
_SHORT_INDEXES: Final = re.compile(rb"(?:\x07\x16\0{7}..\x10\0{3}.{16})++", re.DOTALL)
"""Indexes of one message each."""
_CHECKSUM: Final = struct.Struct("<I")
_SMALL: Final = struct.Struct("<I")
_LARGE: Final = struct.Struct("<Q")
_CHUNK: Final = struct.Struct("<QQQII")
"""First and last log time, size and checksum of the records, length of the compression's name."""
_FOOTER: Final = struct.Struct("<BQQQI")
"""Kind, length, where the summary starts, where its offsets start, checksum."""


class BrokenError(Exception):
    """A record is not what it should be."""


class Taken(NamedTuple):
    """What was taken of a chunk."""

    end: int
    """Where the next record begins."""
    latest: int
    """The latest log time."""


class Runs(Struct, frozen=True):
    """Takes messages many at once: of a long recording most are samples and lines of output."""

    take: Callable[[bytes, int, Mapping[int, ChannelInfo]], Taken]
    """Takes those that begin at a place of a chunk, the first of which is whole, and counts them
    for their channels."""


class ChannelSequence(Struct, frozen=True, eq=False):
    """Channels of messages of equal length behind each other, as they occur again and again."""

    channels: tuple[ChannelInfo, ...]
    stride: int
    """Bytes of each record."""
    times: struct.Struct
    """Unpacks their log times."""


class EqualMessages(NamedTuple):
    """Messages of equal length behind each other."""

    records: bytes
    sequence: ChannelSequence
    latest: int
    """The latest log time."""


class EqualReader:
    """Reads messages of equal length."""

    def __init__(self) -> None:
        self._channels: Mapping[int, ChannelInfo] = {}
        """Of the file that is read."""
        self._known: dict[tuple[int, bytes], ChannelSequence] = {}
        """By length, and the numbers of their channels."""

    def read(self, data: bytes, begin: int, channels: Mapping[int, ChannelInfo]) -> EqualMessages:
        """Read those that begin there, and count them for their channels."""
        if channels is not self._channels or len(self._known) > _MOST_SEQUENCES:
            self._channels, self._known = channels, {}
        stride = RECORD.size + RECORD.unpack_from(data, begin)[1]
        records = equal_records(data, begin)
        numbers = records[NUMBER_AT::stride] + records[NUMBER_AT + 1 :: stride]
        found = self._known.get((stride, numbers))
        if found is None:
            found = _sequence(records, stride, channels)
            records = records[: stride * len(found.channels)]
            if len(found.channels) * 2 == len(numbers):
                self._known[stride, numbers] = found
        for channel in found.channels:
            channel.count += 1
        times = found.times.unpack(records)
        latest = max(times)
        if latest > LATEST:
            latest = max((each for each in times if each <= LATEST), default=0)
        return EqualMessages(records, found, latest)


def _sequence(records: bytes, stride: int, channels: Mapping[int, ChannelInfo]) -> ChannelSequence:
    """Give the channels of the first records that are taken by the same."""
    numbers = struct.Struct(f"<{NUMBER_AT}xH{stride - NUMBER_AT - 2}x").iter_unpack(records)
    known = map(channels.get, (number for (number,) in numbers))
    first = next(known)
    assert first is not None
    same = takewhile(lambda each: each is not None and each.runs == first.runs, known)
    found = (first, *filter(None, same))
    times = struct.Struct("<" + f"15xQ{stride - MESSAGE.size + 8}x" * len(found))
    return ChannelSequence(found, stride, times)


def refuse(kind: int) -> NoReturn:
    raise BrokenError(f"no record of kind {kind:#04x} can stand here")


def is_too_long(kind: int, length: int) -> bool:
    return length > _LIMITS.get(kind, _LIMIT)


def read_content(file: IO[bytes], kind: int, length: int) -> bytes:
    """Read the content of a record, which begins at the position of the file.

    A chunk or attachment is read only when the lengths in it say the same: memory for a wrong
    length may be more than there is.

    Raises:
        BrokenError: When they do not.
    """
    head = file.read(min(length, _HEAD))
    if kind in {Opcode.CHUNK, Opcode.ATTACHMENT} and _inner_length(head, kind) != length:
        what = "a chunk" if kind == Opcode.CHUNK else "an attachment"
        raise BrokenError(f"the length of {what} is wrong")
    return head + file.read(length - _HEAD) if length > _HEAD else head


def end_of_indexes(file: IO[bytes], at: int) -> int:
    """Check the message indexes that begin at ``at``; return where they end.

    Most records are indexes, one for each topic of a chunk: many are read at once.

    Raises:
        BrokenError: When the first one is wrong: another record could have become one.
    """
    file.seek(at)
    try:
        window = file.read(_WINDOW)
    except OSError:  # a sector behind it cannot be read
        file.seek(at)
        window = file.read(_INDEX.size)
    end = 0
    while True:
        end += _whole(_SHORT_INDEXES.match(window, end), _INDEX.size + _ENTRY)
        if len(window) - end < _INDEX.size:
            break
        kind, length, _, size = _INDEX.unpack_from(window, end)
        if kind != Opcode.MESSAGE_INDEX or RECORD.size + length != _INDEX.size + size:
            break
        # That the file has room for the first one is known.
        if end == 0 or end + RECORD.size + length <= len(window):
            end += RECORD.size + length
        else:
            break
    if end == 0:
        raise BrokenError("an index has a wrong length, or is something else")
    return at + end


def equal_records(data: bytes, begin: int) -> bytes:
    """Return the whole record that begins there, and those of its kind and length behind it."""
    head = data[begin : begin + RECORD.size]
    length = RECORD.unpack(head)[1]
    # At most a hundred such expressions are compiled: `re` keeps them.
    found = re.compile(b"(?:%b.{%d})++" % (re.escape(head), length), re.DOTALL).match(data, begin)
    return data[begin : begin + _whole(found, RECORD.size + length)]


def _whole(found: re.Match[bytes] | None, size: int) -> int:
    """Return how many bytes of whole records were found.

    Before Python 3.11.5 a possessive match may end within one.
    """
    matched = 0 if found is None else found.end() - found.start()
    return matched - matched % size


def read_record(read: Callable[[Any], Any], content: bytes) -> Any:
    """Read a record as the package does."""
    try:
        return read(ReadDataStream(BytesIO(content)))
    except Exception as error:
        raise BrokenError(f"a record cannot be read ({type(error).__name__}: {error})") from error


def read_attachment(content: bytes) -> tuple[Attachment, bool]:
    """Read an attachment; return it and whether its checksum is right."""
    attachment: Attachment = read_record(Attachment.read, content)
    (checksum,) = _CHECKSUM.unpack(content[-_CHECKSUM.size :])
    return attachment, checksum in {0, zlib.crc32(content[: -_CHECKSUM.size])}


def read_chunk(content: bytes) -> bytes:
    try:
        _, _, size, checksum, length = _CHUNK.unpack_from(content)
        name = content[_CHUNK.size : _CHUNK.size + length].decode()
        data = memoryview(content)[_CHUNK.size + length + _LARGE.size :]
    except (struct.error, UnicodeDecodeError) as error:
        raise BrokenError(f"a record cannot be read ({type(error).__name__}: {error})") from error
    if size > _LIMITS[Opcode.CHUNK]:
        raise BrokenError(f"a chunk says that it has {size} bytes")
    decompress = _DECOMPRESS.get(name)
    if decompress is None:
        raise BrokenError(f"a chunk is compressed by {name!r}, which is not known")
    try:
        records = decompress(data, size)
    except Exception as error:  # the libraries' own types
        raise BrokenError(f"a chunk cannot be decompressed ({error})") from error
    if checksum not in {0, zlib.crc32(records)}:
        raise BrokenError("the checksum of a chunk is wrong")
    return records


def check_end(file: IO[bytes], size: int, end_of_data: int, described: Collection[bytes]) -> None:
    """Check what follows the data, which ends there: the summary and the end of the file.

    The summary repeats schemas and channels, whose records have no checksum in the data.

    Raises:
        BrokenError: When it is not as it should be.
    """
    footer_at = size - len(MAGIC) - _FOOTER.size
    file.seek(max(0, footer_at))
    footer = file.read()
    is_footer = footer[:1] == bytes([Opcode.FOOTER]) and footer.endswith(MAGIC)
    if footer_at < end_of_data or not is_footer:
        raise BrokenError("the summary at its end is not whole")
    _, _, summary, _, checksum = _FOOTER.unpack_from(footer)
    if (summary or footer_at) != end_of_data:
        raise BrokenError("a record says that the data ends here, and the file goes on")
    # In blocks: a file of days has an index of 100 MB.
    longest, end = max(map(len, described), default=1), size - len(MAGIC) - _CHECKSUM.size
    found, missing, tail = 0, set(described), b""
    file.seek(end_of_data)
    while block := file.read(min(_BLOCK, end - file.tell())):
        found, tail = zlib.crc32(block, found), tail[-longest:] + block
        missing = {record for record in missing if record not in tail}
    if checksum not in {0, found}:
        raise BrokenError("the checksum of the summary is wrong")
    if summary and missing:
        raise BrokenError("a channel or schema is not described as in the summary")


def _inner_length(head: bytes, kind: int) -> int:
    """What the length of a chunk or attachment has to be by what stands in it; -1: nothing fits."""
    try:
        at, texts, rest = (
            (_CHUNK.size - _SMALL.size, 1, 0) if kind == Opcode.CHUNK else (16, 2, _CHECKSUM.size)
        )
        for _ in range(texts):
            at += _SMALL.size + _SMALL.unpack_from(head, at)[0]
        return int(at + _LARGE.size + _LARGE.unpack_from(head, at)[0] + rest)
    except struct.error:
        return -1


def _zstd(data: memoryview, size: int) -> bytes:
    from zstandard import frame_content_size  # noqa: PLC0415 - only what a file needs

    if frame_content_size(data) > size:  # what stands there is allocated
        raise BrokenError("it is larger than its chunk")
    return _decompressor().decompress(data, max_output_size=max(1, size))


@functools.cache
def _decompressor() -> zstandard.ZstdDecompressor:
    from zstandard import ZstdDecompressor  # noqa: PLC0415 - as above

    return ZstdDecompressor()


def _lz4(data: memoryview, size: int) -> bytes:
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]  # noqa: PLC0415

    records: bytes = LZ4FrameDecompressor().decompress(data, max_length=max(1, size))
    return records


_DECOMPRESS: Final[dict[str, Callable[[memoryview, int], bytes]]] = {
    "": lambda data, _size: bytes(data),
    "zstd": _zstd,
    "lz4": _lz4,
}
