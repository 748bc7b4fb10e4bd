"""Single records of an MCAP file, believed only as far as they fit together."""

from __future__ import annotations

import functools
import struct
import zlib
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final, NoReturn

from mcap.data_stream import ReadDataStream
from mcap.records import Attachment, Chunk

if TYPE_CHECKING:
    from collections.abc import Callable

    import zstandard

LARGEST_CHUNK: Final = 1 << 30
"""Bytes; no writer makes larger ones, so a larger number is damage."""
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


class BrokenError(Exception):
    """A record is not what it should be."""


def refuse(kind: int) -> NoReturn:
    """Say that there is no such record."""
    raise BrokenError(f"no record of kind {kind:#04x} can stand here")


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
        BrokenError: When there is something wrong with it, its length included.
    """
    try:
        at = _COMPRESSION + _SMALL.size + _SMALL.unpack_from(content, _COMPRESSION)[0]
        (length,) = _LARGE.unpack_from(content, at)
    except struct.error:
        at, length = len(content), 0
    if at + _LARGE.size + length != len(content):
        raise BrokenError("the length of a chunk is wrong")
    return _decompressed(read_record(Chunk.read, content))


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
