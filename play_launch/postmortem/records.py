"""Single records of an MCAP file, believed only as far as they fit together."""

from __future__ import annotations

import functools
import struct
import zlib
from io import BytesIO
from typing import IO, TYPE_CHECKING, Any, Final, NoReturn

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk

from play_launch.recording.session import METADATA_NAME

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import zstandard

LARGEST_CHUNK: Final = 1 << 30
"""Bytes; no writer makes larger ones, so a larger number is damage."""
_LARGEST: Final[dict[int, int]] = {
    Opcode.CHUNK: LARGEST_CHUNK,
    Opcode.ATTACHMENT: LARGEST_CHUNK,
    Opcode.MESSAGE: 1 << 28,
}
_LARGEST_OTHER: Final = 1 << 24
"""Bytes of a record that describes something."""
_HEAD: Final = 1 << 14
"""Bytes of a record in which its length stands."""
_INDEX: Final = struct.Struct("<HI")
"""Channel and length of the entries, which follow."""
INDEX_HEAD: Final = _INDEX.size
_INDEX_RECORD: Final = struct.Struct("<BQHI")
"""The same, with what precedes each record."""
_INDEX_KIND: Final = int(Opcode.MESSAGE_INDEX)
_LOOK_AHEAD: Final = 4096
"""Bytes that are looked at in one go behind a chunk, where the indexes of its messages stand."""
_CHECKSUM: Final = struct.Struct("<I")
_SMALL: Final = struct.Struct("<I")
_LARGE: Final = struct.Struct("<Q")
_COMPRESSION: Final = 8 + 8 + 8 + 4
"""Bytes of a chunk before the name of its compression."""
_ATTACHMENT_TIMES: Final = 8 + 8
_DAY: Final = 24 * 3600 * 1_000_000_000
_NEVER: Final = 1 << 63
"""A time that no clock shows, in nanoseconds since the epoch: from the year 2262 on."""
_SILENCE: Final = 100 * _DAY
_CLOCKS: Final = 8


class BrokenError(Exception):
    """A record is not what it should be."""


class LogTimes:
    """The log times of a session, as if its clock had not been set while it ran.

    A robot without a battery has its clock set when it reaches a network. Less than a day is not
    noticed, and a jump forward without samples of the machine may be a silence, up to 100 days.
    """

    def __init__(self) -> None:
        """Nothing was set yet."""
        self.has_samples = False
        """Whether there are any of the machine."""
        self._known: tuple[int, ...] = (0,)
        """By how much the clock was ahead of that of the start, the latest first."""

    @property
    def set_ns(self) -> int:
        """By how much the clock is ahead of that of the start."""
        return self._known[0]

    @property
    def note(self) -> str:
        """What is to be said about times, if anything."""
        most = max(self._known, key=abs)
        if not most:
            return ""
        way = "forward" if most > 0 else "back"
        again = "" if most == self.set_ns else ", and set again,"
        return (
            f"the clock was set {way} by {abs(most) / _DAY:,.1f} days{again} while this was "
            "recorded; times after the start are given as if it had not been"
        )

    def likely(self, now: int) -> tuple[int, int]:
        """Give from when to when times are that need no second look; ``now`` is 0: all are."""
        return (max(0, now - _DAY), min(now + _DAY, _NEVER - 1)) if now else (0, _NEVER - 1)

    def take(self, log_time: int, now: int) -> int:
        """Give what to take off an unlikely one; messages may come after later ones."""
        found = log_time - now
        if log_time < _NEVER:
            near = [each for each in self._known if abs(found - each) <= _DAY]
            if near:
                found = near[0]
            elif not self.has_samples and 0 < found - self.set_ns <= _SILENCE:
                found = self.set_ns
            self._known = (found, *(each for each in self._known if each != found))[:_CLOCKS]
        return found if 0 <= log_time - found < _NEVER else log_time - now


def started_ns(metadata: Mapping[str, Mapping[str, str]]) -> int:
    """Give when a session of ours began, by its clock; 0 for other recordings."""
    stamp = metadata.get(METADATA_NAME, {}).get("started_ns", "")
    found = int(stamp) if stamp.isascii() and stamp.isdecimal() and len(stamp) < 20 else 0
    return found if found < _NEVER else 0


def refuse(kind: int) -> NoReturn:
    """Say that there is no such record."""
    raise BrokenError(f"no record of kind {kind:#04x} can stand here")


def is_too_long(kind: int, length: int) -> bool:
    """Whether no record of a kind has so many bytes."""
    return length > _LARGEST.get(kind, _LARGEST_OTHER)


def read_content(file: IO[bytes], kind: int, length: int) -> bytes:
    """Read the content of a record, which begins where the file stands.

    A large one is read only when the lengths in it say the same: memory for a wrong length may be
    more than there is.

    Raises:
        BrokenError: When they do not.
    """
    if kind in {Opcode.CHUNK, Opcode.ATTACHMENT}:
        begin = file.tell()
        head = file.read(min(length, _HEAD))
        inner = _chunk_length(head) if kind == Opcode.CHUNK else _attachment_length(head)
        if inner != length:
            what = "a chunk" if kind == Opcode.CHUNK else "an attachment"
            raise BrokenError(f"the length of {what} is wrong")
        file.seek(begin)
    return file.read(length)


def check_index(head: bytes, length: int) -> None:
    """Check a message index by its first bytes."""
    if len(head) < _INDEX.size or _INDEX.unpack(head)[1] + _INDEX.size != length:
        raise BrokenError("an index has a wrong length, or is something else")


def behind_indexes(file: IO[bytes], at: int, size: int) -> int:
    """Pass over the indexes of messages that are as they should be; return where that ends."""
    unpack, head = _INDEX_RECORD.unpack_from, _INDEX_RECORD.size
    while at < size:
        file.seek(at)
        try:
            block = file.read(_LOOK_AHEAD)
        except OSError:
            return at  # what cannot be read may stand behind them
        begin, last = 0, len(block) - head
        while begin <= last:
            kind, length, _, entries = unpack(block, begin)
            following = begin + 1 + 8 + length
            if kind != _INDEX_KIND or length != entries + INDEX_HEAD or at + following > size:
                return at + begin
            begin = following
        at += begin
        if len(block) < _LOOK_AHEAD:
            return at
    return at


def read_record(read: Callable[[Any], Any], content: bytes) -> Any:
    """Read a record as the package does."""
    stream = ReadDataStream(BytesIO(content))
    try:
        return read(stream)
    except Exception as error:
        raise BrokenError(f"a record cannot be read ({type(error).__name__}: {error})") from error


def read_attachment(content: bytes) -> tuple[Attachment, bool]:
    """Read an attachment; return it and whether its checksum is right."""
    attachment: Attachment = read_record(Attachment.read, content)
    (checksum,) = _CHECKSUM.unpack(content[-_CHECKSUM.size :])
    return attachment, checksum in {0, zlib.crc32(content[: -_CHECKSUM.size])}


def read_chunk(content: bytes) -> bytes:
    """The records in a chunk.

    Raises:
        BrokenError: When there is something wrong with it.
    """
    return _decompressed(read_record(Chunk.read, content))


def _chunk_length(head: bytes) -> int:
    """What the length of a chunk has to be, by what stands in it; negative: nothing fits."""
    try:
        at = _COMPRESSION + _SMALL.size + _SMALL.unpack_from(head, _COMPRESSION)[0]
        return int(at + _LARGE.size + _LARGE.unpack_from(head, at)[0])
    except struct.error:
        return -1


def _attachment_length(head: bytes) -> int:
    """The same of an attachment."""
    try:
        at = _ATTACHMENT_TIMES
        for _ in ("name", "media type"):
            at += _SMALL.size + _SMALL.unpack_from(head, at)[0]
        return int(at + _LARGE.size + _LARGE.unpack_from(head, at)[0] + _CHECKSUM.size)
    except struct.error:
        return -1


def _decompressed(chunk: Chunk) -> bytes:
    if chunk.uncompressed_size > LARGEST_CHUNK:
        raise BrokenError(f"a chunk says that it has {chunk.uncompressed_size} bytes")
    decompress = _DECOMPRESS.get(chunk.compression)
    if decompress is None:
        raise BrokenError(f"a chunk is compressed by {chunk.compression!r}, which is not known")
    try:
        data = decompress(chunk)
    except Exception as error:  # the libraries' own types
        raise BrokenError(f"a chunk cannot be decompressed ({error})") from error
    if chunk.uncompressed_crc not in {0, zlib.crc32(data)}:
        raise BrokenError("the checksum of a chunk is wrong")
    return data


def _zstd(chunk: Chunk) -> bytes:
    return _decompressor().decompress(chunk.data, max_output_size=max(1, chunk.uncompressed_size))


@functools.cache
def _decompressor() -> zstandard.ZstdDecompressor:
    from zstandard import ZstdDecompressor  # noqa: PLC0415 - only what a file needs

    return ZstdDecompressor()


def _lz4(chunk: Chunk) -> bytes:
    from lz4 import frame  # type: ignore[import-untyped]  # noqa: PLC0415

    data: bytes = frame.decompress(chunk.data)
    return data


_DECOMPRESS: Final[dict[str, Callable[[Chunk], bytes]]] = {
    "": lambda chunk: chunk.data,
    "zstd": _zstd,
    "lz4": _lz4,
}
