"""The flight recorder: writes events of a run and chunks of topics, in a thread of its own."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections import Counter, deque
from typing import TYPE_CHECKING, Final

from play_launch.recording import topics
from play_launch.recording.clock import CLOCK_METADATA, SessionClock
from play_launch.recording.console_format import ERROR, line_level
from play_launch.recording.decisions import STATES, Decision, written
from play_launch.recording.errors import RecordingError, SchemaNotFoundError, WriteFailedError
from play_launch.recording.forms import TopicMessage, convert, is_failure, output_message
from play_launch.recording.limits import LOGGER, DroppedEvents, RecorderLimits, RecordingSummary
from play_launch.recording.topics import DROPS_METADATA, Topic
from play_launch.supervisor.events import (
    LogRecord,
    OutputLine,
    RecordingInterrupted,
    RunEvent,
    Sample,
)

if TYPE_CHECKING:
    import re
    from collections.abc import Callable

    from play_launch.recording.bag import BagWriter
    from play_launch.recording.chunk import TopicChunk

_FLOOD: Final = 1000
"""Events in one batch that make it a flood: 20,000 a second."""
_HELD_INPUTS: Final = 200
"""Inputs that wait for an event that they lead to, at most,"""
_HELD_NS: Final = 5_000_000_000
"""and for how long. One by one they would take three times the space."""
_CHANNEL_LIMIT: Final = 65_000
"""Channels of topics: their numbers have 16 bits, and events need some."""
_NO_ROOM: Final = "topics of ROS are not recorded: the disk of %s is nearly full; events still are"
_ROOM_AGAIN: Final = "topics of ROS are recorded again: there is room on the disk of %s"
_log = logging.getLogger(__name__)


class Recorder:
    """Records events.

    :meth:`publish` and requests of `topic_recorder` may come from any thread; they never block and
    never fail. The bag belongs to the recorder's thread. In each turn it writes all events, then
    carries out one request. While the disk takes no data, both wait, events as long as there is
    room; whatever else fails is dropped, counted and logged. The run continues in any case.
    """

    def __init__(
        self,
        bag: BagWriter,
        *,
        limits: RecorderLimits | None = None,
        clock: SessionClock | None = None,
    ) -> None:
        """Register the topics and start the thread; may raise ``RecordingError``."""
        self._bag = bag
        self._limits = limits or RecorderLimits()
        self.clock = clock or SessionClock()
        self._channels = {topic: bag.register(topic) for topic in topics.ALL_TOPICS}
        self._undefined: set[str] = set()
        """Types whose definition is not installed."""
        self._topic_channels: dict[tuple[str, str], int] = {}
        """Channels of topics of ROS by name and type; 0 where the type is not installed."""
        self.secrets: re.Pattern[bytes] | None = None
        """They are masked in messages about parameters."""
        self._topics_have_room = True
        self._lock = threading.RLock()  # its thread may take it twice: a destructor logs anywhere
        self._changed = threading.Condition(self._lock)
        self._events: list[tuple[int, RunEvent]] = []
        """With their log times."""
        self._text = 0
        self._requests: deque[tuple[Callable[[], None], Callable[[], None]]] = deque()
        """What carries each out, and what is called in its place when nothing is written."""
        self._is_urgent = self._is_closing = self._is_closed = False
        self._drops = DroppedEvents(Counter())
        self._topic_drops: Counter[str] = Counter()
        self.dropped = 0
        """Events that were not recorded so far."""
        self._inputs: list[tuple[int, Decision]] = []
        self._held: list[tuple[int, Decision]] = []
        """Inputs that no event has followed yet."""
        self._unwritten = 0
        """Events of the batch under way that are not written yet."""
        self._writing_since = 0
        """Log time of the first event of that batch."""
        self._flush_at = self._flushed_at = 0.0
        self.topic_messages = 0
        """Messages of topics of ROS that were written."""
        self._interruptions = 0
        self.error = ""
        """Why the recording takes no data at the moment, or never again; else empty."""
        self._summary: RecordingSummary | None = None
        self._end = threading.Event()
        # A daemon: the end of the program must not wait for a disk that never answers.
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def topic_drops(self) -> int:
        """Messages of topics of ROS that were not recorded so far."""
        return self._topic_drops.total()

    @property
    def lag(self) -> float:
        """Seconds for which the oldest event waits that is not written yet."""
        with self._lock:
            since = self._writing_since or (self._events[0][0] if self._events else 0)
        return max(self.clock.now() - since, 0) / 1e9 if since else 0.0

    @property
    def waiting(self) -> int:
        """Events and inputs that are to be written."""
        return len(self._events) + len(self._inputs)

    def publish(self, event: RunEvent | Decision) -> None:
        """Take one event, or input; its time of arrival becomes the ``log_time``."""
        is_urgent = not isinstance(event, OutputLine | Decision) and is_failure(event)
        limits = self._limits
        with self._lock:
            received = self.clock.now()  # here, so that they are in the order of their times
            waiting, room = len(self._events) + len(self._inputs), limits.lines
            if isinstance(event, OutputLine):
                self._text += len(event.text)
                room = room if self._text <= limits.text else 0
            elif not isinstance(event, Sample):  # samples come without end as well
                room += limits.other_events
            if self._is_closing or waiting >= room:
                self._drop(event, received)
                return
            if isinstance(event, Decision):
                self._inputs.append((received, event))
            else:
                self._events.append((received, event))
            self._is_urgent = self._is_urgent or is_urgent
            if is_urgent or waiting == 0:
                self._changed.notify()

    def open_channel(
        self, name: str, type_name: str, offered_qos_profiles: str, answer: Callable[[int], None]
    ) -> None:
        """Announce a topic; ``answer`` gets its channel, or 0 when it cannot be recorded."""
        topic = Topic(name, type_name, offered=offered_qos_profiles)
        self._request(lambda: answer(self._register(topic)), lambda: answer(0))

    def append_chunk(self, chunk: TopicChunk, done: Callable[[], None]) -> None:
        """Write a chunk and close its file; ``done`` is called in every case.

        The sender bounds what is under way, see ``topic_recorder/outbox.hpp``.
        """

        def release() -> None:
            if chunk.descriptor >= 0:
                os.close(chunk.descriptor)
            done()

        def write() -> None:
            if not self._can_be_recorded(chunk):
                give_up()
                return
            self._bag.append_chunk(chunk)
            self.topic_messages += chunk.messages
            release()

        def give_up() -> None:
            names = {channel: name for (name, _), channel in self._topic_channels.items()}
            for part in chunk.parts:
                name = names.get(part.channel, f"channel {part.channel}")
                self.count_topic_drops(name, part.messages)
            release()

        self._request(write, give_up)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Put a file of its own into the recording; it is left out when nothing is written."""
        now = self.clock.now()
        self._request(
            lambda: self._bag.attach(name, media_type, data, time=now), give_up=lambda: None
        )

    def after_these(self, done: Callable[[], None]) -> None:
        """Call ``done`` when everything that was requested before is written or given up."""
        self._request(done, done)

    def count_topic_drops(self, topic: str, messages: int) -> None:
        """Note that messages of a topic are not in the recording."""
        with self._changed:
            self._topic_drops[topic] += messages

    def latest(self, topic: Topic, key: str) -> bytes | None:
        """Return the latest message of a topic of ROS with a key, or of a node; in any thread."""
        channel = self._topic_channels.get((topic.name, topic.type_name), 0)
        return self._bag.latest(channel, key)

    def close(self) -> RecordingSummary:
        """Write what is waiting, complete the bag and return the result.

        Blocks for at most ``limits.close`` seconds. Further calls return the same summary.
        """
        if self._summary is None:
            with self._changed:
                self._is_closing = True
                self._changed.notify()
            self._end.set()
            self._thread.join(self._limits.close)
            if self._thread.is_alive():
                self.error = self.error or (
                    f"{self._bag.path} took no data for {self._limits.close:g} s; "
                    "the end of the recording is missing"
                )
            self._summary = RecordingSummary(
                path=self._bag.path,
                messages=self._bag.messages,
                dropped=self.dropped,
                bytes=self._bag.bytes_written,
                parts=self._bag.parts,
                removed_parts=self._bag.removed_parts,
                topic_drops=self.topic_drops,
                interruptions=self._interruptions,
                error=self.error,
            )
        return self._summary

    def _drop(self, event: RunEvent | Decision, received: int) -> None:
        self.dropped += 1
        lines, others, since, _ = self._drops
        if isinstance(event, OutputLine):
            self._text -= len(event.text)
            lines[event.process] += 1
        else:
            others += 1
        self._drops = DroppedEvents(lines, others, since or received, received)

    def _take_drops(self) -> DroppedEvents:
        with self._changed:
            drops, self._drops = self._drops, DroppedEvents(Counter())
        return drops

    def _request(self, carry_out: Callable[[], None], give_up: Callable[[], None]) -> None:
        with self._changed:
            if not self._is_closed:
                self._requests.append((carry_out, give_up))
                self._changed.notify()
                return
        give_up()

    def _run(self) -> None:
        try:
            while not self._is_closed:
                self._turn()
            if self._topic_drops:
                drops = sorted(self._topic_drops.items())
                self._bag.metadata(DROPS_METADATA, {name: str(count) for name, count in drops})
            self._bag.close()
        except RecordingError as error:
            self._stop(str(error))
        except Exception as error:  # noqa: BLE001 - the run must go on whatever fails here
            self._stop(f"the recorder failed: {type(error).__name__}: {error}")
        finally:
            with self._changed:
                self._is_closing = self._is_closed = True
            while self._requests:
                self._requests.popleft()[1]()

    def _turn(self) -> None:
        """Wait for something to do; write all events, then carry out one request.

        At the end all requests of the moment: there are no further events to wait for them.
        """
        bag, limits = self._bag, self._limits
        with self._changed:
            if not (self._events or self._inputs or self._requests or self._is_closing):
                left = self._flush_at - time.monotonic()
                self._changed.wait(max(0.0, left) if bag.has_unflushed else None)
            if self._events and not (self._is_urgent or self._requests or self._is_closing):
                self._changed.wait(limits.batch)
        gap = self._flushed_at + limits.failure_gap - time.monotonic()
        if self._is_urgent and gap > 0 and not self._is_closing:
            time.sleep(gap)
        with self._changed:
            events, self._events, self._text = self._events, [], 0
            inputs, self._inputs = self._inputs, []
            is_urgent, self._is_urgent = self._is_urgent, False
            is_closing, requests = self._is_closing, len(self._requests)
            self._writing_since = events[0][0] if events else 0
        if not bag.has_unflushed:
            self._flush_at = time.monotonic() + limits.flush
        if jump_ns := self.clock.jump_ns():
            values = {"ahead_ns": str(self.clock.ahead_ns)}
            bag.metadata(CLOCK_METADATA, values, is_repeated=True)
            _log.warning("the system clock was set by %+.3f s", jump_ns / 1e9)
        batch: list[tuple[int, RunEvent | list[Decision]]] = [*events]
        self._held += inputs
        if self._held and (decisions := self._followed_inputs(events, is_closing=is_closing)):
            batch.insert(0, (events[0][0] if events else self.clock.now(), decisions))
        if self._drops.since_ns:
            batch.append((self.clock.now(), self._take_drops().report()))
        is_urgent = self._write(batch) or is_urgent
        self._writing_since = 0
        try:
            if bag.has_unflushed and (
                is_urgent or is_closing or time.monotonic() >= self._flush_at
            ):
                bag.flush()
                self._flushed_at = time.monotonic()
            for _ in range(requests if is_closing else min(requests, 1)):
                self._requests[0][0]()
                self._requests.popleft()
        except WriteFailedError as error:
            was_end = self._end.is_set()
            self._wait_for_disk(error)  # events come first, then the request is repeated
            while was_end and self._requests:  # there will be no room for it
                self._requests.popleft()[1]()
        else:
            self._is_closed = is_closing and not self._events

    def _write(self, batch: list[tuple[int, RunEvent | list[Decision]]]) -> bool:
        """Write events and inputs; return whether a line among them was an error."""
        has_error = False
        # In a flood the event loop, busy as well, would keep the lock for 5 ms each time.
        is_flood = len(batch) >= _FLOOD
        for number, (received, event) in enumerate(batch, 1):
            self._unwritten = len(batch) - number
            try:
                messages: tuple[TopicMessage, ...]
                if isinstance(event, list):
                    stamp_ns = received
                    messages = (TopicMessage(topics.INPUTS, written(event)),)
                elif isinstance(event, OutputLine):
                    level = line_level(event)
                    has_error = has_error or level >= ERROR
                    stamp_ns = max(event.stamp_ns, 0)
                    messages = (output_message(event, level),)
                else:
                    stamp_ns, messages = max(event.stamp_ns, 0), convert(event)
            except Exception as error:  # noqa: BLE001 - one odd event must not end the recording
                stamp_ns, messages = received, self._unconvertible(received, event, error)
            for topic, data, key in messages:
                if not (channel := self._channels.get(topic) or self._defined(topic)):
                    self.dropped += 1
                    continue
                times = {"log_time": received, "publish_time": stamp_ns}
                try:
                    self._bag.write(channel, data, **times, key=key)
                except WriteFailedError as error:
                    self._wait_for_disk(error)
            if not is_flood and not number & 63:
                # Otherwise the event loop gets the lock back only after the switch interval, 5 ms.
                time.sleep(0)
        return has_error

    def _followed_inputs(
        self, events: list[tuple[int, RunEvent]], *, is_closing: bool
    ) -> list[Decision]:
        """Return all inputs that are held before an event that they lead to, or when it is time."""
        is_due = is_closing or len(self._held) > _HELD_INPUTS
        is_due = is_due or any(isinstance(event, STATES) for _, event in events)
        if not is_due and self.clock.now() - self._held[0][0] <= _HELD_NS:
            return []
        decisions, self._held = [each for _, each in self._held], []
        return decisions

    def _unconvertible(
        self, received: int, event: RunEvent | list[Decision], error: Exception
    ) -> tuple[TopicMessage, ...]:
        self.dropped += len(event) if isinstance(event, list) else 1
        shown = [type(each.said).__name__ for each in event] if isinstance(event, list) else event
        text = f"cannot record this event ({type(error).__name__}: {error}): {shown!r}"
        return convert(LogRecord(stamp_ns=received, level=ERROR, name=LOGGER, message=text))

    def _defined(self, topic: Topic) -> int:
        """Announce a topic of events; return its channel, or 0 when its type is not installed."""
        if topic.type_name not in self._undefined:
            try:
                self._channels[topic] = self._bag.register(topic)
            except SchemaNotFoundError as error:
                self._undefined.add(topic.type_name)
                _log.error("messages of this type are not recorded: %s", error)
        return self._channels.get(topic, 0)

    def _wait_for_disk(self, error: WriteFailedError) -> None:
        """Return when the bag is flushed; raise when the end of the run comes before."""
        self._interruptions += 1
        self.error = str(error)
        _log.error("the recording is interrupted: %s", error)
        began_ns, since, pause = self.clock.now(), time.monotonic(), self._limits.retry
        while True:
            is_end = self._end.wait(pause)
            pause = min(2 * pause, self._limits.longest_retry)
            if is_end or self._bag.has_room():
                try:
                    self._bag.flush()
                    break
                except WriteFailedError:
                    if is_end:
                        raise
        self.error = ""
        seconds, drops = time.monotonic() - since, self._take_drops()
        lost = f"lost {drops.when}: {drops}" if drops.since_ns else ""
        _log.warning("recording resumed after %.1f s, %s", seconds, lost or "no data lost")
        event = RecordingInterrupted(
            stamp_ns=began_ns, reason=str(error), lasted_ns=round(seconds * 1e9), lost=lost
        )
        with self._changed:
            self._events.insert(0, (self.clock.now(), event))

    def _register(self, topic: Topic) -> int:
        key = topic.name, topic.type_name
        if key not in self._topic_channels:  # a recorder that was restarted requests them again
            if len(self._topic_channels) >= _CHANNEL_LIMIT:
                return 0
            try:
                channel = self._bag.register(topic)
            except SchemaNotFoundError as error:
                _log.warning("topic %s is not recorded: %s", topic.name, error)
                channel = 0
            self._topic_channels[key] = channel
        return self._topic_channels[key]

    def _can_be_recorded(self, chunk: TopicChunk) -> bool:
        """Whether it is what it should be, and leaves room for events on the disk."""
        changes = (topics.PARAMETERS, topics.PARAMETER_EVENTS)
        masked = {self._topic_channels.get((each.name, each.type_name), 0) for each in changes}
        if problem := chunk.checked(masked - {0}, self.secrets):
            _log.error("dropped %d messages of topics: %s", chunk.messages, problem)
            return False
        # To begin again it takes more, so that it is not reported again and again.
        has_room = self._bag.leaves_room(chunk.length * (1 if self._topics_have_room else 4))
        if has_room != self._topics_have_room:
            self._topics_have_room = has_room
            _log.warning(_ROOM_AGAIN if has_room else _NO_ROOM, self._bag.path.parent)
        return has_room

    def _stop(self, error: str) -> None:
        self.error = error
        with self._changed:
            self._is_closing = True
            waiting, self._events = len(self._events), []
            waiting += len(self._inputs) + len(self._held)
        self.dropped += waiting + self._unwritten + self._bag.unflushed_messages
        self._bag.abandon()
        _log.error("the recording stopped: %s", error)
