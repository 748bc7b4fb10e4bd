"""Recordings of several machines as one, on one clock."""

from __future__ import annotations

import heapq
import sys
from bisect import bisect_right
from contextlib import contextmanager
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from play_launch import UserError
from play_launch.recording.clock import CLOCK_METADATA
from play_launch.recording.topics import MACHINES_METADATA, PART_METADATA, REPEATED

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from mcap.reader import McapReader

    from play_launch.recording.folder import PartFile


class MergeError(UserError):
    """A recording cannot be read; the text has its path and the fix."""

    exit_code = 1


_Placed: TypeAlias = tuple[int, int, Any, Any, Any, int]
"""Log time in the result, number of the file, schema, channel, message, publish time."""


class Source(NamedTuple):
    """A recording of one machine."""

    machine: str
    files: Sequence[PartFile]
    offsets: Sequence[tuple[int, int]]
    """Times of its clock, ascending, and by how much it was ahead of the result's then, in ns."""

    def ahead(self, time: int) -> int:
        """Say by how much its clock was ahead at a time of it, between measurements evenly."""
        after = bisect_right(self.offsets, time, key=itemgetter(0))
        around = self.offsets[max(after - 1, 0) : after + 1]
        if not around:
            return 0
        (begin, first), (end, last) = around[0], around[-1]
        if not begin < time < end:
            return first
        return first + (last - first) * (time - begin) // (end - begin)


def merge(sources: Sequence[Source], output: Path) -> int:
    """Write the messages of all to a file, with the head of the first, and return their number.

    Log times and publish times are corrected by the offsets; stamps within messages are not.
    Raises MergeError.
    """
    with output.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="play-launch")
        _copy_head(sources[0].files[0].path, writer)
        offsets = {each.machine: str(each.ahead(sys.maxsize)) for each in sources}
        writer.add_metadata(MACHINES_METADATA, offsets)
        if removed := sum(_removed(source.files[-1].path) for source in sources):
            writer.add_metadata(PART_METADATA, {"first": str(removed)})
        schemas: dict[tuple[str, bytes], int] = {}
        channels: dict[Any, int] = {}
        known: dict[tuple[int, int], int] = {}
        count = 0
        for log_time, number, schema, channel, message, published in heapq.merge(
            *_streams(sources), key=itemgetter(0, 1)
        ):
            key = (number, channel.id)
            if key not in known:
                kind = (schema.name, schema.data)
                if kind not in schemas:
                    schemas[kind] = writer.register_schema(
                        schema.name, schema.encoding, schema.data
                    )
                about = (channel.topic, channel.message_encoding, schemas[kind], channel.metadata)
                same = (*about[:-1], *sorted(channel.metadata.items()))
                if same not in channels:
                    channels[same] = writer.register_channel(*about)
                known[key] = channels[same]
            writer.add_message(
                known[key],
                log_time,
                message.data,
                max(published, 0),
                message.sequence,
            )
            count += 1
        writer.finish()  # type: ignore[no-untyped-call]
    return count


def _streams(sources: Sequence[Source]) -> Iterator[Iterator[_Placed]]:
    number = 0
    for source in sources:
        before = -1
        for path, part in source.files:
            # Of a file that is missing, the next one has the latest messages.
            skips_repeated = part == before + 1 > 0
            yield _messages(number, path, source, skips_repeated=skips_repeated)
            before, number = part, number + 1


def _messages(
    number: int, path: Path, source: Source, *, skips_repeated: bool
) -> Iterator[_Placed]:
    with _opened(path) as reader:
        jump = int(_metadata(reader).get(CLOCK_METADATA, {}).get("ahead_ns", 0))
        for schema, channel, message in reader.iter_messages():
            if skips_repeated and message.sequence == REPEATED:
                continue
            log_time = max(message.log_time - source.ahead(message.log_time), 0)
            late = message.publish_time - message.log_time
            # It may be from after the clock was set, which log times do not follow.
            late -= jump if abs(late - jump) < abs(late) else 0
            yield log_time, number, schema, channel, message, log_time + late


def _removed(path: Path) -> int:
    with _opened(path) as reader:
        return int(_metadata(reader).get(PART_METADATA, {}).get("first", 0))


def _metadata(reader: McapReader) -> Mapping[str, Mapping[str, str]]:
    return {each.name: each.metadata for each in reader.iter_metadata()}


def _copy_head(path: Path, writer: Writer) -> None:
    with _opened(path) as reader:
        for attachment in reader.iter_attachments():
            writer.add_attachment(
                attachment.create_time,
                attachment.log_time,
                attachment.name,
                attachment.media_type,
                attachment.data,
            )
        for metadata in reader.iter_metadata():
            if metadata.name != PART_METADATA:
                writer.add_metadata(metadata.name, metadata.metadata)


@contextmanager
def _opened(path: Path) -> Iterator[McapReader]:
    try:
        with path.open("rb") as file:
            yield make_reader(file)
    except (OSError, McapError) as error:
        raise MergeError(f"{path}: {error}; `play-launch recover {path}` first") from None
