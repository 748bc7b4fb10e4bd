"""Recordings of several machines as one, on one clock."""

from __future__ import annotations

import heapq
import sys
from bisect import bisect_right
from contextlib import ExitStack
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from play_launch import UserError
from play_launch.recording.clock import CLOCK_METADATA
from play_launch.recording.topics import MACHINES_METADATA

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path


class MergeError(UserError):
    """A recording cannot be read; the text has its path and the fix."""

    exit_code = 1


_Placed: TypeAlias = tuple[int, int, Any, Any, Any, int]
"""Log time in the result, number of the file, schema, channel, message, publish time."""


class Source(NamedTuple):
    """A recording of one machine."""

    machine: str
    files: Sequence[Path]
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


def merge(head: Path, sources: Sequence[Source], output: Path) -> int:
    """Write the messages of all to a file, with the head of one, and return their number.

    The first of ``sources`` is usually that of ``head``. Log times and publish times are corrected
    by the offsets; stamps within messages are not. Raises MergeError.
    """
    with ExitStack() as stack:
        file = stack.enter_context(output.open("wb"))
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="play-launch")
        _copy_head(stack, head, writer)
        offsets = {each.machine: str(each.ahead(sys.maxsize)) for each in sources}
        writer.add_metadata(MACHINES_METADATA, offsets)
        streams = [
            _messages(stack, number, path, source)
            for number, (source, path) in enumerate(
                (source, path) for source in sources for path in source.files
            )
        ]
        schemas: dict[tuple[str, bytes], int] = {}
        channels: dict[Any, int] = {}
        count = 0
        for log_time, number, schema, channel, message, published in heapq.merge(
            *streams, key=itemgetter(0, 1)
        ):
            key = (number, channel.id)
            if key not in channels:
                kind = (schema.name, schema.data)
                if kind not in schemas:
                    schemas[kind] = writer.register_schema(
                        schema.name, schema.encoding, schema.data
                    )
                channels[key] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[kind], channel.metadata
                )
            writer.add_message(
                channels[key],
                log_time,
                message.data,
                max(published, 0),
                message.sequence,
            )
            count += 1
        writer.finish()  # type: ignore[no-untyped-call]
    return count


def _messages(stack: ExitStack, number: int, path: Path, source: Source) -> Iterator[_Placed]:
    try:
        reader = make_reader(stack.enter_context(path.open("rb")))
        set_by = {each.name: each.metadata for each in reader.iter_metadata()}
        jump = int(set_by.get(CLOCK_METADATA, {}).get("ahead_ns", 0))
        for schema, channel, message in reader.iter_messages():
            log_time = max(message.log_time - source.ahead(message.log_time), 0)
            late = message.publish_time - message.log_time
            # It may be from after the clock was set, which log times do not follow.
            late -= jump if abs(late - jump) < abs(late) else 0
            yield log_time, number, schema, channel, message, log_time + late
    except (OSError, McapError) as error:
        raise MergeError(f"{path}: {error}; `play-launch recover {path}` first") from None


def _copy_head(stack: ExitStack, path: Path, writer: Writer) -> None:
    try:
        reader = make_reader(stack.enter_context(path.open("rb")))
        for attachment in reader.iter_attachments():
            writer.add_attachment(
                attachment.create_time,
                attachment.log_time,
                attachment.name,
                attachment.media_type,
                attachment.data,
            )
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
    except (OSError, McapError) as error:
        raise MergeError(f"{path}: {error}; `play-launch recover {path}` first") from None
