"""What is recorded of ROS's topics, on its way from their recorder to the thread of ours."""

from __future__ import annotations

import logging
import os
import struct
import threading
import time
from collections import Counter, deque
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.recording.chunk import mask
from play_launch.recording.errors import SchemaNotFoundError, WriteFailedError
from play_launch.recording.topics import PARAMETER_EVENTS, PARAMETERS, Topic

if TYPE_CHECKING:
    import re
    from collections.abc import Callable

    from play_launch.recording.bag import BagWriter
    from play_launch.recording.chunk import TopicChunk

DROPS_METADATA: Final = "play_launch.topic_drops"
"""Metadata record: how many messages of each topic are not in the bag; absent when all are."""

_MOST_CHANNELS: Final = 65_000
"""Their numbers have 16 bits, and others need some."""
_log = logging.getLogger(__name__)


class _Request(NamedTuple):
    carry_out: Callable[[BagWriter], None]
    give_up: Callable[[], None]
    """Called in its place when nothing is written any more."""
    is_repeated: bool = False
    """Whether nothing of it is in the file after a WriteFailedError; else the file holds it back
    until it takes data again."""


class TopicRequests:
    """Requests, taken in any thread and never waiting, carried out by the recorder's thread.

    The requester bounds what is under way, see ``topic_recorder/outbox.hpp``.
    """

    def __init__(self, on_request: Callable[[], None]) -> None:
        """``on_request`` wakes the thread that carries them out."""
        self._on_request = on_request
        self._lock = threading.Lock()
        self._is_open = True
        self._waiting: deque[_Request] = deque()
        self._channels: dict[tuple[str, str], int] = {}
        self._drops: Counter[str] = Counter()
        self.messages = 0
        """That were written."""
        self.secrets: re.Pattern[bytes] | None = None
        """They are masked in messages about parameters."""

    def __bool__(self) -> bool:
        """Whether anything waits."""
        return bool(self._waiting)

    @property
    def dropped(self) -> int:
        """How many messages are not in the recording."""
        return self._drops.total()

    def open_channel(
        self, name: str, type_name: str, offered_qos_profiles: str, answer: Callable[[int], None]
    ) -> None:
        """Announce a topic; ``answer`` gets its channel, or 0 when it cannot be recorded."""
        topic = Topic(name, type_name, offered=offered_qos_profiles)
        self._ask(lambda writer: answer(self._channel(writer, topic)), lambda: answer(0))

    def channel_of(self, topic: Topic) -> int:
        """Give the channel of a topic that was announced, else 0; in any thread."""
        return self._channels.get((topic.name, topic.type_name), 0)

    def append_chunk(self, chunk: TopicChunk, done: Callable[[], None]) -> None:
        """Write a chunk and close its file; ``done`` is called in every case."""

        def let_go() -> None:
            if chunk.descriptor >= 0:
                os.close(chunk.descriptor)
            done()

        def write(writer: BagWriter) -> None:
            if not _is_whole(chunk):
                # No room on the disk would help: only failures to write are outlasted.
                _log.error(
                    "%d messages of topics are lost: their memory cannot be read", chunk.messages
                )
                give_up()
                return
            if not self._is_masked(chunk):
                give_up()
                return
            writer.append_chunk(chunk)
            self.messages += chunk.messages
            let_go()

        def give_up() -> None:
            names = {channel: name for (name, _), channel in self._channels.items()}
            for part in chunk.parts:
                name = names.get(part.channel, f"channel {part.channel}")
                self.count_topic_drops(name, part.messages)
            let_go()

        self._ask(write, give_up, is_repeated=True)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Put a file of its own into the recording; it is left out when nothing is written."""
        now = time.time_ns()
        self._ask(lambda writer: writer.attach(name, media_type, data, time=now), lambda: None)

    def after_these(self, done: Callable[[], None]) -> None:
        """Call ``done`` when everything that was asked for before is written or given up."""
        self._ask(lambda _writer: done(), done)

    def count_topic_drops(self, topic: str, messages: int) -> None:
        """Note that messages of a topic are not in the recording."""
        with self._lock:
            self._drops[topic] += messages

    def carry_out(
        self, writer: BagWriter, outlast: Callable[[WriteFailedError], None], seconds: float
    ) -> bool:
        """Do some of what waits, in the recorder's thread; return whether there was anything.

        Begins none after so many seconds, but one in any case: events of the run wait meanwhile.
        ``outlast`` returns when a file that took no data takes it again.
        """
        until = time.monotonic() + seconds
        count = len(self._waiting)
        for number in range(count):
            if number > 0 and time.monotonic() >= until:
                break
            try:
                self._waiting[0].carry_out(writer)
            except WriteFailedError as error:
                outlast(error)
                if self._waiting[0].is_repeated:
                    break
            self._waiting.popleft()
        return count > 0

    def finish(self, writer: BagWriter) -> None:
        """Put the drops into the bag; before its end."""
        if self._drops:
            drops = sorted(self._drops.items())
            writer.metadata(DROPS_METADATA, {topic: str(count) for topic, count in drops})

    def close(self) -> None:
        """Give up what waits, and whatever comes from now on; in the recorder's thread."""
        with self._lock:
            self._is_open = False
        while self._waiting:
            self._waiting.popleft().give_up()

    def _ask(
        self,
        carry_out: Callable[[BagWriter], None],
        give_up: Callable[[], None],
        *,
        is_repeated: bool = False,
    ) -> None:
        with self._lock:
            is_open = self._is_open
            if is_open:
                self._waiting.append(_Request(carry_out, give_up, is_repeated))
        if is_open:
            self._on_request()
        else:
            give_up()

    def _is_masked(self, chunk: TopicChunk) -> bool:
        if self.secrets is not None:
            channels = {self.channel_of(PARAMETERS), self.channel_of(PARAMETER_EVENTS)}
            try:
                mask(chunk, channels - {0}, self.secrets)
            except (OSError, ValueError, struct.error) as error:
                _log.warning("a chunk may hold secrets and is not recorded: %s", error)
                return False
        return True

    def _channel(self, writer: BagWriter, topic: Topic) -> int:
        # A recorder that was started again asks again.
        known = self._channels.get((topic.name, topic.type_name))
        if known is not None:
            return known
        if len(self._channels) >= _MOST_CHANNELS:
            return 0
        try:
            channel = writer.register(topic)
        except SchemaNotFoundError as error:
            _log.warning("topic %s is not recorded: %s", topic.name, error)
            channel = 0
        self._channels[topic.name, topic.type_name] = channel
        return channel


def _is_whole(chunk: TopicChunk) -> bool:
    try:
        return os.fstat(chunk.descriptor).st_size >= chunk.length
    except OSError:
        return False
