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

if TYPE_CHECKING:
    from collections.abc import Callable

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
"""Bytes of a record in which the numbers stand that say how long it is."""
_INDEX: Final = struct.Struct("<HI")
"""Channel and length of the entries, which follow."""
INDEX_HEAD: Final = _INDEX.size
INDEX: Final = struct.Struct("<BQHI")
"""The same, with what precedes each record."""
_CHECKSUM: Final = struct.Struct("<I")
_SMALL: Final = struct.Struct("<I")
_LARGE: Final = struct.Struct("<Q")
_COMPRESSION: Final = 8 + 8 + 8 + 4
"""Bytes of a chunk before the name of its compression."""


_ATTACHMENT_TIMES: Final = 8 + 8


class BrokenError(Exception):
    """A record is not what it should be."""


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
