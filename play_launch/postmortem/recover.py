"""A damaged or unfinished recording, written anew as far as it can be read, with an index."""

from __future__ import annotations

import contextlib
import fcntl
import os
from typing import IO, TYPE_CHECKING, NamedTuple

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from play_launch import UserError
from play_launch.postmortem.bag_reader import BagReader, NotARecordingError
from play_launch.recording.folder import (
    ACTIVE_SUFFIX,
    HALF_SUFFIX,
    IndexedFile,
    IndexedTopic,
    open_bag,
    part_file,
    parts_of,
    write_index,
)
from play_launch.recording.session import ROS_DISTRO
from play_launch.recording.topics import METADATA_NAME

if TYPE_CHECKING:
    from pathlib import Path


class RecoverError(UserError):
    """Nothing was written; the text has the cause and the fix."""

    exit_code = 1


class Recovered(NamedTuple):
    """The result; ``reader`` knows what could not be read."""

    path: Path
    messages: int
    reader: BagReader
    last_offset: int
    """Where in the file the last message stands that was read."""


def default_output(path: Path) -> Path:
    """``session.mcap`` for ``session.mcap.active``, else ``x.recovered.mcap`` for ``x.mcap``."""
    if path.name.endswith(ACTIVE_SUFFIX):
        return path.with_name(path.name.removesuffix(ACTIVE_SUFFIX))
    return path.with_name(f"{path.name.removesuffix('.mcap')}.recovered.mcap")


def recover(path: Path, output: Path, *, replace: bool = False) -> Recovered:
    """Write what can be read of ``path`` to ``output``, with an index.

    The file itself is not changed. ``output`` appears when it is whole. Where it is a file of the
    session beside ``path``, the folder gets the index that makes it a bag to rosbag2.
    ``replace`` permits that ``output`` exists.

    Raises:
        RecoverError: When the file is no recording, is being written, or ``output`` exists or
            cannot be written.
    """
    if output.exists() and not replace:
        raise RecoverError(f"{output} exists; name another file with --output")
    try:
        with open_bag(path) as source:
            _refuse_what_is_written(path, source)
            target = output.resolve() if output.is_symlink() else output
            recovered = write_whole(path, target)._replace(path=output)
    except NotARecordingError as error:
        raise RecoverError(str(error)) from error
    except OSError as error:
        raise RecoverError(f"{error.filename or path}: {error.strerror}") from error
    if output.parent == path.parent and part_file(output) is not None:
        # The file is whole without it.
        with contextlib.suppress(OSError, NotARecordingError):
            index_folder(output.parent)
    return recovered


def write_whole(path: Path, output: Path) -> Recovered:
    """Do the same; the caller makes sure that no other process uses the files.

    Raises:
        NotARecordingError: When the file is no recording.
        RecoverError: When the output cannot be written.
    """
    half = output.with_name(output.name + HALF_SUFFIX)
    try:
        with half.open("wb") as file:
            reader, count, last_offset = _copy(path, file)
            os.fsync(file.fileno())
        half.rename(output)
    except NotARecordingError:
        half.unlink(missing_ok=True)
        raise
    except OSError as error:
        half.unlink(missing_ok=True)
        raise RecoverError(f"{error.filename or half}: {error.strerror}") from error
    return Recovered(output, count, reader, last_offset)


def index_folder(folder: Path) -> None:
    """Write ``metadata.yaml`` for the files of a session that are complete.

    Raises:
        OSError: When something cannot be read or written.
        NotARecordingError: When a file has no summary.
    """
    parts = [part.path for part in parts_of(folder) if not part.is_active]
    files, distros = [], []
    for path in parts:
        file, distro = _indexed(path)
        files.append(file)
        distros.append(distro)
    write_index(folder, files, next(filter(None, distros), ""))


def _refuse_what_is_written(path: Path, file: IO[bytes]) -> None:
    # Its writer holds a lock as long as it lives.
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise RecoverError(f"{path} is being written by a running session; stop that") from error


def _copy(path: Path, file: IO[bytes]) -> tuple[BagReader, int, int]:
    reader = BagReader(path)
    writer = Writer(file, compression=CompressionType.ZSTD)
    writer.start("ros2", "play_launch recover")
    attached, described = set[str](), set[str]()
    schemas, channels = dict[int, int](), dict[int, int]()
    count = last_offset = 0

    def copy_head() -> None:
        for name in reader.attachments.keys() - attached:
            each = reader.attachments[name]
            writer.add_attachment(each.create_time, each.log_time, name, each.media_type, each.data)
        attached.update(reader.attachments)
        for name in reader.metadata.keys() - described:
            writer.add_metadata(name, reader.metadata[name])
        described.update(reader.metadata)

    for message in reader.messages():
        if len(reader.attachments) > len(attached) or len(reader.metadata) > len(described):
            copy_head()
        number = channels.get(message.channel)
        if number is None:
            one = reader.channels[message.channel]
            channel, schema = one.channel, one.schema
            new = schemas.get(schema.id) if schema else 0
            if schema and new is None:
                new = writer.register_schema(schema.name, schema.encoding, schema.data)
                schemas[schema.id] = new
            number = channels[message.channel] = writer.register_channel(
                channel.topic, channel.message_encoding, new or 0, channel.metadata
            )
        writer.add_message(
            number, message.log_time, message.data, message.publish_time, message.sequence
        )
        count += 1
        last_offset = reader.offset
    copy_head()
    writer.finish()  # type: ignore[no-untyped-call]
    return reader, count, last_offset


def _indexed(path: Path) -> tuple[IndexedFile, str]:
    """Give what the index says of a file, and the ROS distribution that it was recorded with."""
    try:
        with path.open("rb") as file:
            reader = make_reader(file)
            summary = reader.get_summary()
            about = {one.name: one.metadata for one in reader.iter_metadata()}
    except (McapError, ValueError, EOFError) as error:
        raise NotARecordingError(f"{path}: {error}") from error
    if summary is None or summary.statistics is None:
        raise NotARecordingError(f"{path}: it has no summary")
    statistics = summary.statistics
    counts: dict[IndexedTopic, int] = {}
    for number, channel in summary.channels.items():
        schema = summary.schemas.get(channel.schema_id)
        topic = IndexedTopic(
            channel.topic,
            schema.name if schema else "",
            channel.metadata.get("offered_qos_profiles", ""),
        )
        count = statistics.channel_message_counts.get(number, 0)
        counts[topic] = counts.get(topic, 0) + count
    begin, end = statistics.message_start_time, statistics.message_end_time
    distro = about.get(METADATA_NAME, {}).get(ROS_DISTRO, "")
    return IndexedFile(path.name, begin, end, counts), distro
