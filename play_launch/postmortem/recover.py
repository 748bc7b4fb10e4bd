"""A damaged or unfinished recording, written anew as far as it can be read."""

from __future__ import annotations

import contextlib
import fcntl
import os
from pathlib import Path
from typing import IO, TYPE_CHECKING, NamedTuple

from mcap.writer import CompressionType, Writer

from play_launch.postmortem.bag_reader import BagReader, NotARecordingError
from play_launch.postmortem.index_folder import index_folder
from play_launch.postmortem.whole_file import OutputError, is_passed_on, whole_file
from play_launch.recording.folder import ACTIVE_SUFFIX, HALF_SUFFIX, open_bag, part_file

if TYPE_CHECKING:
    from pathlib import Path

    from play_launch.postmortem.bag_reader import Message


class RecoverError(Exception):
    """Nothing was written; the text has the cause and the fix."""


class Recovered(NamedTuple):
    """The result; ``reader`` knows what could not be read."""

    path: Path
    messages: int
    reader: BagReader
    last_offset: int = 0
    """Where in the file the last message stands that was read."""


def default_output(path: Path) -> Path:
    """``session.mcap`` for ``session.mcap.active``, else ``x.recovered.mcap`` for ``x.mcap``."""
    if path.name.endswith(ACTIVE_SUFFIX):
        return path.with_name(path.name.removesuffix(ACTIVE_SUFFIX))
    return path.with_name(f"{path.name.removesuffix('.mcap')}.recovered.mcap")


def recover(path: Path, output: Path) -> Recovered:
    """Write what can be read of ``path`` to ``output``, with an index.

    The file itself is not changed. ``output`` appears when it is whole. Where it is a file of the
    session beside ``path``, the folder gets the index that makes it a bag to rosbag2.

    Raises:
        RecoverError: When the file is no recording, is being written, or ``output`` exists or
            cannot be written.
    """
    is_through = is_passed_on(output)
    if output.exists() and not is_through:
        raise RecoverError(f"{output} exists; name another file with --output")
    try:
        with open_bag(path) as source:
            _refuse_what_is_written(path, source)
            if is_through:
                with whole_file(output) as file:
                    recovered = write_whole(path, file)._replace(path=output)
            else:
                target = output.resolve() if output.is_symlink() else output
                recovered = write_whole(path, target)._replace(path=output)
    except (NotARecordingError, OutputError) as error:
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
    copied = _Copied(reader, writer)
    count = last_offset = 0
    for message in reader.messages():
        copied.head()
        writer.add_message(
            copied.channel(message),
            message.log_time + message.set_ns,
            message.data,
            message.publish_time,
            message.sequence,
        )
        count += 1
        last_offset = message.offset
    copied.head()
    writer.finish()  # type: ignore[no-untyped-call]
    return reader, count, last_offset


class _Copied:
    """What the new file has already of the old one."""

    def __init__(self, reader: BagReader, writer: Writer) -> None:
        self._reader = reader
        self._writer = writer
        self._channels: dict[int, int] = {}
        self._schemas: dict[int, int] = {}
        self._attached: set[str] = set()
        self._metadata: set[str] = set()

    def head(self) -> None:
        """Copy the attachments and metadata that were read since."""
        reader = self._reader
        if len(reader.attachments) > len(self._attached):
            for name in reader.attachments.keys() - self._attached:
                each = reader.attachments[name]
                self._writer.add_attachment(
                    each.create_time, each.log_time, name, each.media_type, each.data
                )
                self._attached.add(name)
        if len(reader.metadata) > len(self._metadata):
            for name in reader.metadata.keys() - self._metadata:
                self._writer.add_metadata(name, reader.metadata[name])
                self._metadata.add(name)

    def channel(self, message: Message) -> int:
        """Give the number of a message's channel in the new file."""
        number = self._channels.get(message.channel)
        if number is None:
            described = self._reader.channels[message.channel]
            channel, schema = described.channel, described.schema
            new = 0
            if schema is not None:
                new = self._schemas.get(schema.id) or self._writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
                self._schemas[schema.id] = new
            number = self._writer.register_channel(
                channel.topic, channel.message_encoding, new, channel.metadata
            )
            self._channels[message.channel] = number
        return number
