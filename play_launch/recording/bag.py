"""A bag: MCAP files that follow each other, each of which can be read without the others."""

from __future__ import annotations

import contextlib
import logging
import math
import queue
import re
import struct
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.config.model import RotateConfig
from play_launch.container.cdr.structure import Layout
from play_launch.recording.errors import WriteFailedError, reason
from play_launch.recording.folder import (
    IndexedFile,
    IndexedTopic,
    is_own,
    part_file,
    part_path,
    write_index,
)
from play_launch.recording.mcap_file import McapFile
from play_launch.recording.topics import PARAMETERS, PART_METADATA, REPEATED, message_definition

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from play_launch.recording.chunk import TopicChunk
    from play_launch.recording.topics import Topic

_ROTATION_RETRY: Final = 10.0
"""Seconds until the next file is tried again."""
_UNFLUSHED_LIMIT: Final = 64 * 1024
"""Bytes of whole chunks that wait for a flush, at most: a full chunk is flushed at once."""
_LONG: Final = 4
"""Times the room after which a full disk is tried again: topics and further files leave it."""
_LEAST_FILES: Final = 4
"""Files that a limit of the recording has room for, so that removing one leaves much of it."""
_LEAST_SIZE: Final = 1e6
"""Bytes of a file that are worth a head of their own, whatever the limit is."""
_LATCHED_LIMIT: Final = 100
_LATCHED_SIZE_LIMIT: Final = 1024 * 1024
"""Messages of a latched topic that are repeated, and their bytes; the latest is in any case."""
_NODE: Final = Layout("stamp:t node:s")
"""How a message of `PARAMETERS` begins."""
_TRANSIENT_LOCAL: Final = re.compile(r"\bdurability: 1\b")
_INFINITE_LIFESPAN: Final = re.compile(r"\blifespan:\s*\{?\s*sec: (?:9223372036|2147483647)\b")
_log = logging.getLogger(__name__)


class _Latched(NamedTuple):
    data: bytes
    publish_time: int


class BagWriter:
    """Writes ``<path>``, then ``<path>_1``, ``<path>_2``; ``.active`` until they are complete.

    Profile ``ros2``, every channel ``cdr`` with a ``ros2msg`` schema. Each file begins with what
    was attached before the first message, the topics, and the latest messages of what holds until
    further notice: states by their key, parameters by their node, latched topics of ROS (of these
    several messages, as the number of publishers is not known).

    Times are nanoseconds since the epoch. Only :meth:`flush`, :meth:`append_chunk` and
    :meth:`close` touch the disk and may raise ``WriteFailedError``. What was written is not lost
    then: it waits for the next :meth:`flush`. Belongs to one thread, but for :meth:`latest`.
    """

    def __init__(
        self,
        path: Path,
        *,
        definition: Callable[[str], str] = message_definition,
        rotation: RotateConfig | None = None,
        limit: float = math.inf,
        sync: float = math.inf,
        has_index: bool = False,
        ros_distro: str = "",
        now: Callable[[], int] = time.time_ns,
    ) -> None:
        """Create the file; it must not exist.

        ``definition`` gives the text of a message type, and is called once for each. Beyond
        ``limit`` bytes of all files the oldest are removed, but for the latest two. Every ``sync``
        seconds what was flushed is forced to the disk. With an index, which names ``ros_distro``,
        the folder of the file is a bag to rosbag2. ``now`` gives log times.
        """
        self._first_path = path
        self._definition = definition
        rotation = rotation or RotateConfig(math.inf, math.inf)
        self._limit = limit
        self._size = min(rotation.size, max(limit / _LEAST_FILES, _LEAST_SIZE))
        self._duration = rotation.duration
        self._has_index = has_index
        self._ros_distro = ros_distro
        self._now = now
        self._topics: dict[int, Topic] = {}
        self._definitions: dict[str, str] = {}
        self._head: dict[str, Callable[[McapFile], None]] = {}
        self._has_messages = False
        self.has_unflushed = False
        """Whether something was put into the bag since the last flush."""
        self._by_key: dict[tuple[int, str], _Latched] = {}
        self._by_topic: dict[int, deque[_Latched]] = {}
        self._finished: tuple[tuple[int, int], ...] = ()
        """Bytes and messages of the files that are complete and stay."""
        self._number = 0
        self._repeated = 0
        self._not_before = 0.0
        self._completed: list[IndexedFile] = []
        """Belongs to the thread of the disk."""
        self._file = self._begin(0)
        self._disk = _DiskThread(sync)

    @property
    def path(self) -> Path:
        """Where the data is now: the file, or the folder when there are several."""
        return self._file.path if self._number == 0 else self._first_path.parent

    @property
    def parts(self) -> int:
        """Number of files."""
        return len(self._finished) + 1

    @property
    def removed_parts(self) -> int:
        """Number of files that were removed, the oldest ones."""
        return self._number - len(self._finished)

    @property
    def bytes_written(self) -> int:
        """Size of the files."""
        return sum(size for size, _ in self._finished) + self._file.committed

    @property
    def messages(self) -> int:
        """Messages that are in the files; those that are repeated count once."""
        finished = sum(messages for _, messages in self._finished)
        return finished + self._file.committed_messages - self._repeated

    @property
    def unflushed_messages(self) -> int:
        """Messages that are not in the files."""
        return self._file.messages - self._file.committed_messages

    def register(self, topic: Topic) -> int:
        """Announce a topic and return its channel; may raise ``SchemaNotFoundError``."""
        definition = self._definitions.get(topic.type_name)
        if definition is None:
            definition = self._definitions[topic.type_name] = self._definition(topic.type_name)
        channel = self._file.register(topic, definition)
        self._topics[channel] = topic
        return channel

    def write(
        self, channel: int, data: bytes, *, log_time: int, publish_time: int, key: str = ""
    ) -> None:
        """Append one CDR-serialised message (with its 4-byte encapsulation header).

        The latest message of each ``key`` of a channel is repeated when another file is begun.
        """
        self._has_messages = self.has_unflushed = True
        if key:
            self._by_key[channel, key] = _Latched(data, publish_time)
        file = self._file
        file.add(channel, data, log_time=log_time, publish_time=publish_time)
        if file.size - file.committed > _UNFLUSHED_LIMIT:
            self.flush()

    def append_chunk(self, chunk: TopicChunk) -> None:
        """Append messages of registered channels that are in a chunk already; they are flushed.

        When it fails, nothing of the chunk is in the bag: it is to be appended again.
        """
        self._has_messages = True
        self._file.append_chunk(chunk)
        # It is in the file now: whatever is wrong with it, it is not to be appended again.
        with contextlib.suppress(OSError, struct.error, ValueError):
            self._note_latched(chunk)
        self.flush()  # nothing is left to write

    def latest(self, channel: int, key: str) -> bytes | None:
        """Return the latest message with a key, or of a node; in any thread."""
        found = self._by_key.get((channel, key))
        return found and found.data

    def attach(self, name: str, media_type: str, data: bytes, *, time: int) -> None:
        self._put(name, lambda file: file.attach(name, media_type, data, time=time))

    def metadata(self, name: str, values: Mapping[str, str], *, is_repeated: bool = False) -> None:
        """Append a metadata record; further files begin with the latest one if it ``is_repeated``.

        So do they with whatever comes before the first message.
        """
        self._put(name, lambda file: file.metadata(name, values), is_repeated=is_repeated)

    def flush(self) -> None:
        """Pass everything to the kernel: it then survives the death of this process."""
        file = self._file
        file.commit()
        self.has_unflushed = False
        self._disk.sync_soon(file)
        now = time.monotonic()
        if (
            file.committed_messages > self._repeated
            and (file.committed >= self._size or now - file.begun >= self._duration)
            and now >= self._not_before
            and self.leaves_room()
        ):
            self._rotate()

    def has_room(self) -> bool:
        """Whether it is worth while to flush again after that failed."""
        return self._has_room(0, 1)

    def leaves_room(self, more: int = 0) -> bool:
        """Whether events have room for a long time after so many bytes, or another file."""
        return self._has_room(more, _LONG)

    def _has_room(self, more: int, times: int) -> bool:
        try:
            return self._file.has_room(more, times)
        except OSError:
            return False

    def close(self) -> None:
        """Complete the file, make it durable and give it its final name."""
        self._file.finish()
        self._complete(self._file, self.removed_parts)
        self._disk.close()

    def abandon(self) -> None:
        """Close the file as it is; what was flushed stays readable. Never raises."""
        self._disk.do(self._file, self._file.abandon)
        with contextlib.suppress(WriteFailedError):
            self._disk.close()

    def _put(
        self, name: str, record: Callable[[McapFile], None], *, is_repeated: bool = False
    ) -> None:
        if is_repeated or not self._has_messages:
            self._head[name] = record
        self.has_unflushed = True
        record(self._file)

    def _begin(self, number: int, first: int = 0) -> McapFile:
        """Make a file with everything that it needs to be read alone; those from ``first`` stay."""
        file = McapFile(part_path(self._first_path, number))
        try:
            for record in self._head.values():
                record(file)
            if number > 0:
                file.metadata(PART_METADATA, {"number": str(number), "first": str(first)})
            for topic in self._topics.values():
                file.register(topic, self._definitions[topic.type_name])
            now = self._now()  # playback begins with the file's earliest log time
            for channel, (data, stamp) in self._latched():
                file.add(channel, data, log_time=now, publish_time=stamp, sequence=REPEATED)
            file.commit()
        except BaseException:
            file.abandon()
            file.path.unlink(missing_ok=True)
            raise
        return file

    def _latched(self) -> Iterator[tuple[int, _Latched]]:
        for (channel, _), message in self._by_key.items():
            yield channel, message
        for channel, messages in self._by_topic.items():
            for message in messages:
                yield channel, message

    def _note_latched(self, chunk: TopicChunk) -> None:
        for part in chunk.parts:
            topic = self._topics[part.channel]
            if topic.name == PARAMETERS.name:
                for data, stamp in chunk.messages_of(part):
                    self._by_key[part.channel, _NODE.read(data)["node"]] = _Latched(data, stamp)
            elif is_latched(topic.offered):
                kept = self._by_topic.setdefault(part.channel, deque())
                kept.extend(_Latched(*message) for message in chunk.messages_of(part))
                size = sum(len(message.data) for message in kept)
                while len(kept) > 1 and (size > _LATCHED_SIZE_LIMIT or len(kept) > _LATCHED_LIMIT):
                    size -= len(kept.popleft().data)

    def _rotate(self) -> None:
        old = self._file
        finished = (*self._finished, (old.committed, old.committed_messages - self._repeated))
        surplus = self._size - self._limit + sum(size for size, _ in finished)
        while len(finished) > 1 and surplus > 0 and not self._is_pinned():
            surplus -= finished[0][0]
            finished = finished[1:]
        first = self._number + 1 - len(finished)
        try:
            following = self._begin(self._number + 1, first)
        except WriteFailedError as error:
            self._not_before = time.monotonic() + _ROTATION_RETRY
            _log.warning(
                "cannot begin another file, the recording stays in %s: %s", old.path, error
            )
            return
        try:
            old.finish()
        except WriteFailedError as error:
            _log.error("%s; the next start completes it", error)
            self._disk.do(old, old.abandon)
        else:
            self._complete(old, first)
        self._finished = (*finished[:-1], (old.committed, finished[-1][1]))
        self._file, self._number = following, self._number + 1
        self._repeated = following.committed_messages
        self._disk.sync_soon(following)

    def _is_pinned(self) -> bool:
        try:
            return not all(is_own(path) for path in self._first_path.parent.iterdir())
        except OSError:
            return True

    def _complete(self, file: McapFile, first: int) -> None:
        name, known = part_path(self._first_path, self._number).name, file.statistics
        counts = {
            IndexedTopic(
                topic.name, topic.type_name, topic.offered_qos_profiles
            ): known.channel_message_counts.get(channel, 0)
            for channel, topic in self._topics.items()
        }
        indexed = IndexedFile(name, known.message_start_time, known.message_end_time, counts)

        def complete() -> None:
            file.complete()
            self._completed.append(indexed)
            folder = self._first_path.parent
            parts = [] if first == 0 else filter(None, map(part_file, folder.iterdir()))
            removed = [part.path for part in parts if part.number < first]
            names = {path.name for path in removed}
            self._completed = [each for each in self._completed if each.name not in names]
            try:
                if self._has_index:
                    write_index(folder, self._completed, self._ros_distro)
            except OSError as error:  # each file is whole without it
                _log.warning("cannot write the index of %s: %s", self._first_path, reason(error))
            self._remove(removed)

        self._disk.do(file, complete)

    def _remove(self, files: list[Path]) -> None:
        for path in files:
            try:
                path.unlink()
            except OSError as error:  # the next rotation tries it again
                _log.warning("%s cannot be removed: %s", path, reason(error))
                return
            _log.info("removed %s: the recording is larger than record.keep.size", path)


class _DiskThread:
    """Syncs what was flushed, at most ``period`` seconds after it was, and completes files.

    An SD card may take seconds for it, in which the recorder would not empty its queue. The first
    error of each file is logged at once; the first one of a job is raised by `close` as well.
    """

    def __init__(self, period: float) -> None:
        """``period`` may be infinite: then a file is synced when it is complete."""
        self._period = period
        self._jobs: queue.SimpleQueue[tuple[McapFile, Callable[[], None] | None] | None]
        self._jobs = queue.SimpleQueue()
        self._awaited: set[McapFile] = set()
        """They are going to be synced with what they have now."""
        self._failed: McapFile | None = None
        self._error: WriteFailedError | None = None
        self._closing = threading.Event()
        # A daemon: the end of the program must not wait for a disk that never answers.
        self._thread = threading.Thread(target=self._run, name="recorder-disk", daemon=True)
        self._thread.start()

    def sync_soon(self, file: McapFile) -> None:
        """Note that a file has something new; never blocks."""
        if self._period < math.inf and file not in self._awaited:
            self._awaited.add(file)
            self._jobs.put((file, None))

    def do(self, file: McapFile, job: Callable[[], None]) -> None:
        """Do something with a file after the jobs before; it may raise ``OSError``."""
        self._jobs.put((file, job))

    def close(self) -> None:
        """Wait for the jobs; raise the first error of one. Nothing may follow."""
        self._closing.set()
        self._jobs.put(None)
        self._thread.join()
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        while (item := self._jobs.get()) is not None:
            file, job = item
            if job is None:
                if self._closing.wait(self._period):
                    continue  # a job for the file follows
                self._awaited.discard(file)
            try:
                (job or file.sync)()
            except OSError as error:
                if job is not None:
                    self._error = self._error or WriteFailedError(file.path, error)
                self._report(file, error)

    def _report(self, file: McapFile, error: OSError) -> None:
        if self._failed is file or self._closing.is_set():
            return
        self._failed = file
        if isinstance(error, FileNotFoundError):
            _log.error("%s was removed: recording resumes at the next start", file.path)
        else:
            cause = reason(error)
            _log.error("%s cannot be synced: %s; a power failure may lose it", file.path, cause)


def is_latched(offered_qos_profiles: str) -> bool:
    """Whether all publishers keep their messages for late subscribers, without limit."""
    profiles = offered_qos_profiles.count("durability:")
    return (
        profiles > 0
        and len(_TRANSIENT_LOCAL.findall(offered_qos_profiles)) == profiles
        and len(_INFINITE_LIFESPAN.findall(offered_qos_profiles)) == profiles
    )
