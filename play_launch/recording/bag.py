"""A bag as the recorder wants one, and as MCAP: one file, or several that follow each other."""

from __future__ import annotations

import contextlib
import logging
import math
import struct
import time
from typing import TYPE_CHECKING, Final, Protocol

from msgspec import Struct

from play_launch.container.cdr.layout import CdrError
from play_launch.recording.disk import Disk
from play_launch.recording.errors import WriteFailedError, reason
from play_launch.recording.index import IndexedFile, IndexedTopic, write_index
from play_launch.recording.latched import Latched
from play_launch.recording.part import ACTIVE_SUFFIX, Part, part_path
from play_launch.recording.schema import message_definition

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from play_launch.recording.chunk import TopicChunk
    from play_launch.recording.topics import Topic

PART_METADATA: Final = "play_launch.part"
"""Every file but the first has it, with its ``number`` (from 1 on)."""
REPEATED: Final = 0
"""The sequence number of messages that repeat the latest ones of the files before; others have
higher ones."""
_PATIENCE: Final = 10.0
"""Seconds until the next file is tried again."""
_log = logging.getLogger(__name__)


class BagWriter(Protocol):
    """A bag that is being written.

    All times are nanoseconds since the epoch. Every method may raise
    :class:`~play_launch.recording.errors.WriteFailedError`. What it was given is not lost then:
    after :meth:`flush` has worked again, everything is in the bag. Until then nothing but
    :meth:`has_room`, :meth:`flush`, :meth:`close` and :meth:`abandon` may follow. A writer belongs
    to one thread at a time, but for :meth:`latest`.
    """

    @property
    def path(self) -> Path:
        """Where the data is now: the file, or the folder when there are several."""

    @property
    def parts(self) -> int:
        """How many files there are."""

    @property
    def bytes_written(self) -> int:
        """Size of the files in bytes."""

    @property
    def messages(self) -> int:
        """Messages in the files: those that :meth:`flush` has reached, or a full chunk."""

    def register(self, topic: Topic) -> int:
        """Announce a topic and return its channel, to be given to :meth:`write`."""

    def write(
        self, channel: int, data: bytes, *, log_time: int, publish_time: int, key: str = ""
    ) -> None:
        """Append one CDR-serialised message (with its 4-byte encapsulation header).

        The latest message of each ``key`` of a channel is repeated when another file is begun.
        """

    def append_chunk(self, chunk: TopicChunk) -> None:
        """Append messages of registered channels that are in a chunk already.

        When it fails, nothing of the chunk is in the bag: it is to be appended again.
        """

    def latest(self, channel: int, key: str) -> bytes | None:
        """Give the latest message with a key, or of a node; None without one. In any thread."""

    def attach(self, name: str, media_type: str, data: bytes, *, time: int) -> None:
        """Put a file of its own into the bag."""

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Put a record of names and values into the bag."""

    def flush(self) -> None:
        """Hand everything over to the kernel: it then survives the death of this process."""

    def has_room(self) -> bool:
        """Whether it is worth while to :meth:`flush` again after that failed."""

    def close(self) -> None:
        """Complete the file, make it durable and give it its final name."""

    def abandon(self) -> None:
        """Close the file as it is; what was flushed stays readable. Never raises."""


class Rotation(Struct, frozen=True):
    """When another file is begun: at so many bytes, after so many seconds."""

    size: float = math.inf
    duration: float = math.inf


class McapBagWriter:
    """Writes ``<path>.active``, renamed to ``path`` when it is complete; then ``<path>_1``, ``_2``.

    Profile ``ros2``, zstd chunks, every channel ``cdr`` with a ``ros2msg`` schema. Each file can be
    read without the others: it begins with what was attached before the first message, with the
    topics, and with what is latched. Implements :class:`BagWriter`.
    """

    def __init__(
        self,
        path: Path,
        *,
        library: str = "play_launch",
        definition: Callable[[str], str] = message_definition,
        rotation: Rotation | None = None,
        sync: float = math.inf,
        has_index: bool = False,
        ros_distro: str = "",
    ) -> None:
        """Create the file; it must not exist.

        ``definition`` gives the text of a message type. Every ``sync`` seconds what was written is
        forced to the disk. With an index, which names ``ros_distro``, the folder of the file is a
        bag to rosbag2. Raises :class:`WriteFailedError`.
        """
        self._first_path = path
        self._library = library
        self._definition = definition
        self._rotation = rotation or Rotation()
        self._has_index = has_index
        self._ros_distro = ros_distro
        self._topics: dict[int, Topic] = {}
        self._definitions: dict[str, str] = {}
        """By type, as they were when its first topic was announced: the package may be built again
        or removed since, and messages of that topic still have this form."""
        self._head: list[Callable[[Part], None]] = []
        self._has_begun = False
        self._latched = Latched()
        self._completed: list[IndexedFile] = []
        """Belongs to the thread of the disk."""
        self._finished_bytes = 0
        self._finished_messages = 0
        self._number = 0
        self._repeated = 0
        self._not_before = 0.0
        self._disk = Disk(sync, self._not_durable)
        with self._failing():
            self._part = self._begin(0)

    @property
    def path(self) -> Path:
        """Where the data is now."""
        return self._part.path if self._number == 0 else self._first_path.parent

    @property
    def parts(self) -> int:
        """How many files there are."""
        return self._number + 1

    @property
    def bytes_written(self) -> int:
        """Size of the files in bytes."""
        return self._finished_bytes + self._part.file.committed

    @property
    def messages(self) -> int:
        """Messages that are in the files; those that are repeated count once."""
        return self._finished_messages + self._part.committed_messages - self._repeated

    def register(self, topic: Topic) -> int:
        """Announce a topic; may raise ``SchemaNotFoundError``, and nothing else."""
        if topic.type_name not in self._definitions:
            self._definitions[topic.type_name] = self._definition(topic.type_name)
        channel = len(self._topics) + 1
        self._topics[channel] = topic
        self._part.register(channel, topic, self._definitions[topic.type_name])
        return channel

    def write(
        self, channel: int, data: bytes, *, log_time: int, publish_time: int, key: str = ""
    ) -> None:
        """Append one message; a full chunk goes to the file at once."""
        self._has_begun = True
        if key:
            self._latched.note(channel, key, data, publish_time)
        try:
            self._part.write(channel, data, log_time=log_time, publish_time=publish_time)
        except OSError as error:
            raise WriteFailedError(self._active_path, error) from error

    def append_chunk(self, chunk: TopicChunk) -> None:
        """Append a chunk; it is with the kernel then, as is everything before."""
        self._has_begun = True
        with self._failing():
            self._part.append_chunk(chunk)
        # It is in the file now: whatever is wrong with it, it is not to be appended again.
        with contextlib.suppress(OSError, struct.error, CdrError):
            self._latched.note_chunk(chunk, self._topics)
        self._committed()

    def latest(self, channel: int, key: str) -> bytes | None:
        """See :class:`BagWriter`."""
        return self._latched.latest(channel, key)

    def attach(self, name: str, media_type: str, data: bytes, *, time: int) -> None:
        """Put a file of its own into the bag."""
        self._put(lambda part: part.attach(name, media_type, data, time=time))

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Put a record of names and values into the bag."""
        self._put(lambda part: part.metadata(name, values))

    def flush(self) -> None:
        """End the chunk, so that everything written so far is with the kernel."""
        with self._failing():
            self._part.commit()
        self._committed()

    def has_room(self) -> bool:
        """Whether it is worth while to flush again after that failed."""
        try:
            return self._part.file.has_room()
        except OSError:
            return False

    def close(self) -> None:
        """Write the summary, make the file durable and give it its final name."""
        with self._failing():
            self._finish()
        self._disk.close()

    def abandon(self) -> None:
        """Cut the file after the last complete record and close it."""
        self._disk.do(self._part, self._part.abandon)
        with contextlib.suppress(WriteFailedError):
            self._disk.close()

    @property
    def _active_path(self) -> Path:
        path = part_path(self._first_path, self._number)
        return path.with_name(path.name + ACTIVE_SUFFIX)

    def _committed(self) -> None:
        self._disk.written(self._part)
        if self._is_full():
            self._go_on_in_another_file()

    def _put(self, record: Callable[[Part], None]) -> None:
        if not self._has_begun:
            self._head.append(record)
        with self._failing():
            record(self._part)
            self._part.file.commit()

    def _begin(self, number: int) -> Part:
        """Make a file with all that it needs to be read alone."""
        part = Part(part_path(self._first_path, number), library=self._library)
        try:
            for record in self._head:
                record(part)
            if number > 0:
                part.metadata(PART_METADATA, {"number": str(number)})
            for channel, topic in self._topics.items():
                part.register(channel, topic, self._definitions[topic.type_name])
            # They arrived before; but playback begins with the file's earliest log time.
            now = time.time_ns()
            for channel, data, publish_time in self._latched:
                part.write(
                    channel, data, log_time=now, publish_time=publish_time, sequence=REPEATED
                )
            part.commit()
        except BaseException:
            part.abandon()
            part.path.unlink(missing_ok=True)
            raise
        return part

    def _is_full(self) -> bool:
        part = self._part
        return (
            part.committed_messages > self._repeated
            and (
                part.file.committed >= self._rotation.size
                or time.monotonic() - part.begun >= self._rotation.duration
            )
            and time.monotonic() >= self._not_before
        )

    def _go_on_in_another_file(self) -> None:
        try:
            following = self._begin(self._number + 1)
            try:
                self._finish()
            except OSError:
                following.abandon()
                following.path.unlink(missing_ok=True)
                raise
        except OSError as error:
            self._not_before = time.monotonic() + _PATIENCE
            _log.warning(
                "cannot begin another file, the recording stays in %s: %s",
                self._part.path,
                reason(error),
            )
            return
        self._finished_bytes += self._part.file.committed
        self._finished_messages += self._part.committed_messages - self._repeated
        self._part, self._number = following, self._number + 1
        self._repeated = following.committed_messages
        self._disk.written(following)

    def _finish(self) -> None:
        part = self._part
        summary = part.finish()
        counts = {_listed(self._topics[each]): count for each, count in summary.counts.items()}
        name = part_path(self._first_path, self._number).name
        file = IndexedFile(name, summary.begin, summary.end, counts)
        self._disk.do(part, lambda: self._complete(part, file))

    def _complete(self, part: Part, file: IndexedFile) -> None:
        part.complete()
        self._completed.append(file)
        if not self._has_index:
            return
        try:
            write_index(self._first_path.parent, self._completed, self._ros_distro)
        except OSError as error:
            # Each file is whole without it.
            _log.warning("cannot write the index of %s: %s", self._first_path, reason(error))

    def _not_durable(self, part: Part, error: OSError) -> None:
        if isinstance(error, FileNotFoundError):
            _log.error(
                "%s was removed: what happens is not recorded until the next start", part.path
            )
            return
        _log.error(
            "%s cannot be forced to the disk: %s; a power failure may take it",
            part.path,
            reason(error),
        )

    @contextlib.contextmanager
    def _failing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise WriteFailedError(self._active_path, error) from error


def _listed(topic: Topic) -> IndexedTopic:
    return IndexedTopic(topic.name, topic.type_name, topic.offered_qos_profiles)
