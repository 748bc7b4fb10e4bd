"""Records of an MCAP file, accepted only as far as they fit together."""

from __future__ import annotations

import functools
import struct
import zlib
from io import BytesIO
from typing import IO, TYPE_CHECKING, Any, Final, NoReturn

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk

from play_launch.recording.mcap_file import MAGIC

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    import zstandard

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
INDEX: Final = struct.Struct("<HI")
"""Channel and length of the entries, which follow."""
_CHECKSUM: Final = struct.Struct("<I")
_SMALL: Final = struct.Struct("<I")
_LARGE: Final = struct.Struct("<Q")
_COMPRESSION: Final = 8 + 8 + 8 + 4
"""Bytes of a chunk before the name of its compression."""
_FOOTER: Final = struct.Struct("<BQQQI")
"""Kind, length, where the summary starts, where its offsets start, checksum."""


class BrokenError(Exception):
    """A record is not what it should be."""


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
    if kind in {Opcode.CHUNK, Opcode.ATTACHMENT}:
        begin = file.tell()
        if _inner_length(file.read(min(length, _HEAD)), kind) != length:
            what = "a chunk" if kind == Opcode.CHUNK else "an attachment"
            raise BrokenError(f"the length of {what} is wrong")
        file.seek(begin)
    return file.read(length)


def is_wrong_index(head: bytes, length: int) -> bool:
    """Check a message index by its first bytes: another record could have become one."""
    return len(head) < INDEX.size or INDEX.unpack(head)[1] + INDEX.size != length


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
    """Return the records in a chunk."""
    chunk: Chunk = read_record(Chunk.read, content)
    if chunk.uncompressed_size > _LIMITS[Opcode.CHUNK]:
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
        at, texts, rest = (_COMPRESSION, 1, 0) if kind == Opcode.CHUNK else (16, 2, _CHECKSUM.size)
        for _ in range(texts):
            at += _SMALL.size + _SMALL.unpack_from(head, at)[0]
        return int(at + _LARGE.size + _LARGE.unpack_from(head, at)[0] + rest)
    except struct.error:
        return -1


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
