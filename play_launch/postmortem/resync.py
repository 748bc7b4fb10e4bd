"""Where a record or a chunk begins behind a place that makes no sense."""

from __future__ import annotations

import struct
from typing import IO, Final

from mcap.opcode import Opcode

_NAMES: Final = tuple(struct.pack("<I", len(name)) + name for name in (b"zstd", b"lz4"))
"""How a chunk is compressed stands behind its head; an uncompressed one has nothing to be found
by."""
_BEFORE: Final = 1 + 8 + 8 + 8 + 8 + 4
"""Bytes of a chunk before that: kind, length, first and last log time, size, checksum."""
_KINDS: Final = range(Opcode.HEADER, Opcode.DATA_END + 1)
_LENGTH: Final = struct.Struct("<Q")
_BLOCK: Final = 1024 * 1024
_PIECE: Final = 64 * 1024
"""Bytes that are looked at in one go where some cannot be read."""
_OVERLAP: Final = _BEFORE + max(map(len, _NAMES))


def next_chunk(file: IO[bytes], begin: int, size: int) -> int | None:
    """Find the first chunk at or behind `begin` that fits into the file; None without one.

    Args:
        file: It is left anywhere.
        begin: In bytes.
        size: Of the file.
    """
    at, step = begin, _BLOCK
    while at < size:
        try:
            file.seek(at)
            block = file.read(step + _OVERLAP)
        except OSError:
            if step > _PIECE:
                step = _PIECE
                continue
            block = b""
        found = [place for name in _NAMES for place in _places(block, name, at, size)]
        if found:
            return min(found)
        at += step
    return None


def may_begin(file: IO[bytes], at: int, size: int) -> bool:
    """Whether a record may begin there."""
    try:
        file.seek(at)
        return at == size or (file.read(1) or b"\0")[0] in _KINDS
    except OSError:
        return False


def _places(block: bytes, name: bytes, offset: int, size: int) -> list[int]:
    """Where chunks with this compression begin in a block, which itself is at `offset`."""
    found = []
    at = block.find(name)
    while at >= 0:
        begin = at - _BEFORE
        if begin >= 0 and block[begin] == Opcode.CHUNK:
            (length,) = _LENGTH.unpack_from(block, begin + 1)
            if offset + begin + 9 + length <= size:
                found.append(offset + begin)
        at = block.find(name, at + 1)
    return found
