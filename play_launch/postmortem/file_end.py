"""Whether a file ends as a whole one does: with a summary that fits what comes before."""

from __future__ import annotations

import os
import struct
import zlib
from typing import IO, TYPE_CHECKING, Final

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from play_launch.postmortem.records import BrokenError, read_record

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

MAGIC: Final = b"\x89MCAP0\r\n"
_FOOTER: Final = struct.Struct("<BQQQI")
"""Kind, length, where the summary starts, where its offsets start, checksum."""
_DATA_END: Final = 9 + 4
_HEAD: Final = struct.Struct("<BQ")
"""Kind and length of a record."""


class NotTheEndError(Exception):
    """The record stands within the data: it is not what it says."""


def problem_at_the_end(
    file: IO[bytes],
    at: int,
    kind: int,
    channels: Mapping[int, Channel],
    schemas: Mapping[int, Schema],
) -> str | None:
    """Describe what is wrong with what follows the data; None if it is right.

    Args:
        file: It is left anywhere.
        at: Where the record stands that ends the data.
        kind: Its opcode.
        channels: As the data describes them; no checksum says that they are right, but the summary
            repeats them.
        schemas: The same.

    Raises:
        NotTheEndError: When the data goes on.
    """
    end = file.seek(0, os.SEEK_END) - len(MAGIC) - _FOOTER.size
    file.seek(max(end, 0))
    tail = file.read()
    if end < at or not tail.endswith(MAGIC) or tail[0] != Opcode.FOOTER:
        return "the summary at its end is not whole"
    _, _, summary, _, checksum = _FOOTER.unpack_from(tail)
    begin = at + _DATA_END if kind == Opcode.DATA_END else at
    if begin != (summary or end):
        raise NotTheEndError
    file.seek(begin)
    covered = file.read(end - begin) + tail[: _FOOTER.size - 4]
    if checksum not in {0, zlib.crc32(covered)}:
        return "the checksum of the summary is wrong; play-launch recover writes another one"
    try:
        for repeated in _described(covered):
            is_channel = isinstance(repeated, Channel)
            known = channels.get(repeated.id) if is_channel else schemas.get(repeated.id)
            if known is not None and known != repeated:
                what = "channel" if is_channel else "schema"
                return f"{what} {repeated.id} is not described as in the summary"
    except BrokenError as error:
        return f"in the summary: {error}"
    return None


def _described(summary: bytes) -> Iterator[Channel | Schema]:
    at = 0
    while len(summary) - at >= _HEAD.size:
        kind, length = _HEAD.unpack_from(summary, at)
        at += _HEAD.size
        content = summary[at : at + length]
        at += length
        if kind == Opcode.CHANNEL:
            yield read_record(Channel.read, content)
        elif kind == Opcode.SCHEMA:
            yield read_record(Schema.read, content)
