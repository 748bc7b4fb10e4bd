"""A bag as the recorder wants one, and as MCAP, written with the package ``mcap``."""

from __future__ import annotations

import contextlib
import fcntl
import os
from typing import IO, TYPE_CHECKING, Final, Protocol, Self, cast

from mcap.writer import CompressionType, Writer

from play_launch.recording.errors import WriteFailedError
from play_launch.recording.schema import message_definition

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path
    from types import TracebackType

    from play_launch.recording.topics import Topic

ACTIVE_SUFFIX: Final = ".active"
"""Appended to the name of a bag while it is written."""

_CHUNK_SIZE: Final = 960 * 1024
"""Bytes, uncompressed. The chunk ends *after* the message that exceeds it; the distance to 1 MiB
is for that message."""


class BagWriter(Protocol):
    """A bag that is being written.

    All times are nanoseconds since the epoch. Every method may raise
    :class:`~play_launch.recording.errors.WriteFailedError`; after that only :meth:`abandon` may
    follow. A writer belongs to one thread at a time.
    """

    @property
    def path(self) -> Path:
        """Where the data is now; it changes once, when :meth:`close` succeeds."""

    @property
    def bytes_written(self) -> int:
        """Size of the file in bytes."""

    @property
    def messages(self) -> int:
        """Messages in the file: those that :meth:`flush` has reached, or a full chunk."""

    def register(self, topic: Topic) -> int:
        """Announce a topic and return its channel, to be given to :meth:`write`."""

    def write(self, channel: int, data: bytes, *, log_time: int, publish_time: int) -> None:
        """Append one CDR-serialised message (with its 4-byte encapsulation header)."""

    def attach(self, name: str, media_type: str, data: bytes, *, time: int) -> None:
        """Put a file of its own into the bag."""

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Put a record of names and values into the bag."""

    def flush(self) -> None:
        """Hand everything over to the kernel: it then survives the death of this process."""

    def close(self) -> None:
        """Complete the file, make it durable and give it its final name."""

    def abandon(self) -> None:
        """Let go of the file as it is; what was flushed stays readable. Never raises."""


class McapBagWriter:
    """Writes ``<path>.active`` and renames it to ``path`` when it is complete.

    Profile ``ros2``, zstd chunks, every channel ``cdr`` with a ``ros2msg`` schema. Implements
    :class:`BagWriter`.
    """

    def __init__(
        self,
        path: Path,
        *,
        library: str = "play_launch",
        definition: Callable[[str], str] = message_definition,
    ) -> None:
        """Create the file; it must not exist.

        ``definition`` gives the text of a message type. Raises :class:`WriteFailedError`.
        """
        self._final_path = path
        self._path = path.with_name(path.name + ACTIVE_SUFFIX)
        self._definition = definition
        self._schemas: dict[str, int] = {}
        self._sequences: dict[int, int] = {}
        with self._failing():
            self._file = _AppendingFile(self._path)
        self._writer = Writer(
            # The package asks for a stream and calls write, tell and flush only.
            cast("IO[bytes]", self._file),
            chunk_size=_CHUNK_SIZE,
            compression=CompressionType.ZSTD,
        )
        self._messages = 0
        self._readable_messages = 0
        self._readable_until = 0
        with self._failing():
            self._writer.start(profile="ros2", library=library)
            self._mark()

    @property
    def path(self) -> Path:
        """Where the data is now."""
        return self._path

    @property
    def bytes_written(self) -> int:
        """Size of the file in bytes."""
        return self._file.position

    @property
    def messages(self) -> int:
        """Messages that are in the file."""
        return self._readable_messages

    def register(self, topic: Topic) -> int:
        """Announce a topic; may raise ``SchemaNotFoundError``."""
        schema = self._schemas.get(topic.type_name)
        with self._failing():
            if schema is None:
                text = self._definition(topic.type_name).encode()
                schema = self._writer.register_schema(topic.type_name, "ros2msg", text)
                self._schemas[topic.type_name] = schema
            return self._writer.register_channel(
                topic.name,
                "cdr",
                schema,
                {"offered_qos_profiles": topic.offered_qos_profiles},
            )

    def write(self, channel: int, data: bytes, *, log_time: int, publish_time: int) -> None:
        """Append one message; a full chunk goes to the file at once."""
        sequence = self._sequences.get(channel, 0) + 1
        self._sequences[channel] = sequence
        try:
            self._writer.add_message(channel, log_time, data, publish_time, sequence & 0xFFFFFFFF)
        except OSError as error:
            raise self._failed(error) from error
        self._messages += 1
        if self._file.position != self._readable_until:
            self._mark()

    def attach(self, name: str, media_type: str, data: bytes, *, time: int) -> None:
        """Put a file of its own into the bag."""
        with self._failing():
            self._writer.add_attachment(time, time, _text(name), media_type, data)
            self._mark()

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Put a record of names and values into the bag."""
        with self._failing():
            self._writer.add_metadata(name, {key: _text(value) for key, value in values.items()})
            self._mark()

    def flush(self) -> None:
        """End the chunk, so that everything written so far is with the kernel."""
        with self._failing():
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._mark()

    def close(self) -> None:
        """Write the summary, make the file durable and give it its final name."""
        with self._failing():
            self.flush()
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._mark()
            self._file.sync()
            self._file.close()
            self._path.rename(self._final_path)
            self._path = self._final_path
            _sync_folder(self._final_path.parent)

    def abandon(self) -> None:
        """Cut the file after the last complete record and let go of it."""
        with contextlib.suppress(OSError):
            self._file.truncate(self._readable_until)
        with contextlib.suppress(OSError):
            self._file.close()

    def _mark(self) -> None:
        """Everything up to here can be read, whatever happens next."""
        self._readable_until = self._file.position
        self._readable_messages = self._messages

    def _failing(self) -> _Translate:
        return _Translate(self)

    def _failed(self, error: OSError) -> WriteFailedError:
        return WriteFailedError(self._path, error)


class _Translate:
    """Turns an ``OSError`` of the file into :class:`WriteFailedError`."""

    def __init__(self, writer: McapBagWriter) -> None:
        self._writer = writer

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(error, OSError):
            raise self._writer._failed(error) from error  # noqa: SLF001 - one class in two parts


class _AppendingFile:
    """A file without a buffer of its own.

    Python's buffered writer keeps what it could not write, and tries again (and raises again)
    when it is closed or collected; a recording that has met a full disk must be able to let go.
    Chunks arrive in one piece, so a buffer would save nothing.
    """

    def __init__(self, path: Path) -> None:
        self.position = 0
        self._descriptor = -1
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        with contextlib.suppress(OSError):  # a file system without locks
            # As long as it is held, the file is being written: see `history.recover`.
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def write(self, data: bytes) -> int:
        rest = memoryview(data)
        while rest:
            count = os.write(self._descriptor, rest)
            self.position += count
            rest = rest[count:]
        return len(data)

    def tell(self) -> int:
        return self.position

    def flush(self) -> None:
        """Nothing is held back."""

    def sync(self) -> None:
        os.fsync(self._descriptor)

    def truncate(self, size: int) -> None:
        if self._descriptor >= 0:
            os.ftruncate(self._descriptor, size)
            self.position = size

    def close(self) -> None:
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def __del__(self) -> None:
        self.close()


def _text(text: str) -> str:
    """Text as MCAP can hold it: a file name that is not Unicode is written with escapes."""
    return text.encode("utf-8", "backslashreplace").decode()


def _sync_folder(folder: Path) -> None:
    """Make a rename durable, where the file system can."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    except OSError:
        # Some file systems (FUSE, network) refuse this for a folder; the file itself is synced.
        pass
    finally:
        os.close(descriptor)
