"""The flight recorder: takes the events of a run and writes them from a thread of its own."""

from __future__ import annotations

import logging
import math
import threading
import time
from datetime import datetime
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.recording import topics
from play_launch.recording.console_format import ERROR, WARN
from play_launch.recording.convert import Recorded, convert, convert_output, is_failure
from play_launch.recording.decisions import STATES, Decision, written
from play_launch.recording.errors import RecordingError, SchemaNotFoundError, WriteFailedError
from play_launch.recording.event_queue import EventQueue
from play_launch.recording.topic_requests import TopicRequests
from play_launch.supervisor.events import (
    LogRecord,
    OutputLine,
    RecordingInterrupted,
    RunEvent,
)

if TYPE_CHECKING:
    from pathlib import Path

    from play_launch.recording.bag import BagWriter
    from play_launch.recording.event_queue import Drops
    from play_launch.recording.topics import Topic

_LOGGER: Final = "play_launch.recording"
_FLOOD: Final = 1000
"""Events in one batch that make it a flood: 20,000 a second."""
_HELD: Final = 200
"""Inputs that wait for an event that they lead to, at most,"""
_LONGEST_HELD_NS: Final = 5_000_000_000
"""and for how long. One by one they would take three times the space."""
_log = logging.getLogger(__name__)


class RecorderLimits(Struct, frozen=True):
    """Sizes and times of a recorder; the defaults suit a run of a few hundred nodes."""

    lines: int = 50_000
    """Output lines waiting to be written; further ones are dropped and counted."""
    text: int = 32 * 1024 * 1024
    """Characters of output waiting to be written."""
    other_events: int = 10_000
    """Room for other events when ``lines`` is used up: a flood of output must not drive out the
    state events."""
    batch: float = 0.05
    """Seconds to gather events before they are written together."""
    flush: float = 0.05
    """Seconds that a written message may wait for the end of its chunk. Together with ``batch``
    this is what a SIGKILL can cost; it leaves 0.15 s of the promised 0.25 s to a busy machine."""
    failure_gap: float = 0.01
    """Least seconds between two chunks that end early because of a failure."""
    retry: float = 0.5
    """Seconds until a file that took no data is tried again; twice as long each time, up to"""
    longest_retry: float = 10.0
    """so many seconds."""
    close: float = 10.0
    """Seconds to wait at the end for what is still to be written."""


class RecordingSummary(Struct, frozen=True):
    """Result of a recording."""

    path: Path
    """The file; it still ends in ``.active`` when it could not be completed. With several files
    the folder that holds them."""
    messages: int
    """Messages that are in it."""
    dropped: int
    """Events that are not in it."""
    bytes: int
    parts: int = 1
    """Number of files."""
    topic_drops: int = 0
    """Messages of ROS's topics that are not in it."""
    interruptions: int = 0
    """How often it took no data for some time, for example on a full disk."""
    error: str = ""
    """Why the recording stopped early, and the fix; empty when it is complete."""


class Recorder:
    """An :class:`~play_launch.supervisor.events.EventSink` that records.

    :meth:`publish` may be called from any thread; it never blocks and never fails. The file
    belongs to the recorder's thread. While that cannot write, because the disk is full or for
    another reason, events wait as long as there is room for them, and the file is tried again and
    again. The run goes on in any case; what happens to the recording is logged.
    """

    def __init__(self, writer: BagWriter, *, limits: RecorderLimits | None = None) -> None:
        """Register the topics and start the thread; may raise ``RecordingError``."""
        self._writer = writer
        self._limits = limits or RecorderLimits()
        self._channels: dict[Topic, int] = {
            topic: writer.register(topic) for topic in topics.ALL_TOPICS
        }
        self._undefined: set[str] = set()
        """Types whose definition is not installed."""
        self._queue = EventQueue(self._limits)
        self._wake = threading.Event()
        self.topic_requests = TopicRequests(self._wake.set)
        """Where topics of ROS come in, as finished chunks."""
        self._lost = 0
        """Events that were taken from the queue and are not recorded."""
        self._held: list[Decision] = []
        """Inputs that no event has followed yet."""
        self._held_since = 0
        self._unwritten = 0
        """Events of the batch under way that the writer has not got yet."""
        self._handed = 0
        """Messages that the writer has got."""
        self._unflushed = 0
        self._interruptions = 0
        self._resumed: list[RecordingInterrupted] = []
        """Interruptions that are over and not recorded yet."""
        self._error = ""
        self._summary: RecordingSummary | None = None
        self._hurry = threading.Event()
        self._end = threading.Event()
        # A daemon: the end of the program must not wait for a disk that never answers.
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Events that were not recorded so far."""
        return self._queue.dropped + self._lost

    @property
    def waiting(self) -> int:
        """Events that are to be written."""
        return len(self._queue)

    @property
    def error(self) -> str:
        """Why the recording takes no data at the moment, or never again; else empty."""
        return self._error

    def latest(self, topic: Topic, key: str) -> bytes | None:
        """Give the latest message of a topic of ROS with a key, or of a node; in any thread."""
        channel = self.topic_requests.channel_of(topic)
        return self._writer.latest(channel, key) if channel else None

    def publish(self, event: RunEvent | Decision) -> None:
        """Take one event, or input; its time of arrival becomes the ``log_time``."""
        is_first = self._queue.put(event)
        if not isinstance(event, OutputLine | Decision) and is_failure(event):
            self._hurry.set()
            self._wake.set()
        elif is_first:
            self._wake.set()

    def close(self) -> RecordingSummary:
        """Write what is waiting, complete the file and return the result.

        Blocks for at most ``limits.close`` seconds. Further calls return the same summary.
        """
        if self._summary is None:
            self._queue.close()
            self._end.set()
            self._hurry.set()
            self._wake.set()
            self._thread.join(self._limits.close)
            if self._thread.is_alive():
                self._error = self._error or (
                    f"{self._writer.path} took no data for {self._limits.close:g} s; "
                    "the end of the recording is missing"
                )
            self._summary = RecordingSummary(
                path=self._writer.path,
                messages=self._writer.messages,
                dropped=self.dropped,
                bytes=self._writer.bytes_written,
                parts=self._writer.parts,
                topic_drops=self.topic_requests.dropped,
                interruptions=self._interruptions,
                error=self._error,
            )
        return self._summary

    def _run(self) -> None:
        try:
            self._record()
            self.topic_requests.finish(self._writer)
            self._writer.close()
        except RecordingError as error:
            self._stop(str(error))
        except Exception as error:  # noqa: BLE001 - the run must go on whatever fails here
            self._stop(f"the recorder failed: {type(error).__name__}: {error}")
        finally:
            self.topic_requests.close()

    def _record(self) -> None:
        flush_at = 0.0
        flushed_at = 0.0
        while True:
            waiting = max(0.0, flush_at - time.monotonic()) if self._unflushed else None
            if self.topic_requests:
                pass  # the last turn left some of them, as events come first
            elif self._wake.wait(waiting):
                if self._hurry.is_set():
                    gap = flushed_at + self._limits.failure_gap - time.monotonic()
                    if gap > 0 and not self._end.is_set():
                        time.sleep(gap)
                else:
                    self._hurry.wait(self._limits.batch)
            hurried = self._hurry.is_set()
            self._hurry.clear()
            self._wake.clear()
            batch, drops, closing = self._queue.take()
            if not self._unflushed:
                flush_at = time.monotonic() + self._limits.flush
            failed = self._write_batch(batch, closing=closing)
            if drops:
                self._write(time.time_ns(), _drop_report(drops))
            if self._unflushed and (hurried or failed or closing or time.monotonic() >= flush_at):
                self._flush()
                flushed_at = time.monotonic()
            # At the end there are no other events to wait for it.
            seconds = math.inf if closing else self._limits.batch
            if self.topic_requests.carry_out(self._writer, self._outlast, seconds):
                self._unflushed = 0  # what is before a chunk goes to the file with it
            while self._resumed:
                self._write(time.time_ns(), self._resumed.pop(0))
                self._flush()
            if closing:
                return

    def _write_batch(self, batch: list[tuple[int, RunEvent | Decision]], *, closing: bool) -> bool:
        """Write events; return whether a line among them was an error."""
        failed = False
        # In a flood the event loop is busy as well and would in turn keep the lock for 5 ms each
        # time: then only an equal share keeps up.
        polite = len(batch) < _FLOOD
        self._unwritten = len(batch)
        self._hold_decisions(batch, closing=closing)
        for number, (received, event) in enumerate(batch):
            if isinstance(event, OutputLine):
                recorded, level = convert_output(event)
                self._hand(received, event.stamp_ns, recorded)
                failed = failed or level >= ERROR
            elif not isinstance(event, Decision):
                self._write(received, event)
            self._unwritten -= 1
            if polite and not number & 63:
                # Gives up the interpreter lock; otherwise the event loop gets it back only after
                # the switch interval, 5 ms.
                time.sleep(0)
        return failed

    def _hold_decisions(
        self, batch: list[tuple[int, RunEvent | Decision]], *, closing: bool
    ) -> None:
        """Take the inputs of a batch, and write all of them before an event that they lead to."""
        is_due = closing
        for received, each in batch:
            if isinstance(each, Decision):
                self._held_since = self._held_since if self._held else received
                self._held.append(each)
            is_due = is_due or isinstance(each, STATES)
            is_due = is_due or abs(received - self._held_since) > _LONGEST_HELD_NS
        if self._held and (is_due or len(self._held) > _HELD):
            self._write_decisions(batch[0][0] if batch else time.time_ns())

    def _write_decisions(self, received: int) -> None:
        decisions, self._held = self._held, []
        try:
            data = written(decisions)
        except Exception as error:  # noqa: BLE001 - one odd input must not end the recording
            self._lost += len(decisions)
            kinds = [type(each.said).__name__ for each in decisions]
            self._write(received, _unconvertible(received, kinds, error))
            return
        self._hand(received, received, Recorded(topics.INPUTS, data))

    def _write(self, received: int, event: RunEvent) -> None:
        try:
            converted = convert(event)
        except Exception as error:  # noqa: BLE001 - one odd event must not end the recording
            self._lost += 1
            converted = convert(_unconvertible(received, event, error))
        for recorded in converted:
            self._hand(received, event.stamp_ns, recorded)

    def _hand(self, received: int, stamp_ns: int, recorded: Recorded) -> None:
        topic, data, key = recorded
        channel = self._channel(topic)
        if channel is None:
            self._lost += 1
            return
        self._unflushed += 1
        try:
            self._writer.write(
                channel,
                data,
                log_time=received,
                publish_time=max(stamp_ns, 0),
                key=key,
            )
        except WriteFailedError as error:
            self._outlast(error)
        self._handed += 1

    def _flush(self) -> None:
        try:
            self._writer.flush()
        except WriteFailedError as error:
            self._outlast(error)
        self._unflushed = 0

    def _outlast(self, error: WriteFailedError) -> None:
        """Return when the file takes data again; raise when the end of the run comes before."""
        self._interruptions += 1
        self._error = str(error)
        _log.error("the recording is interrupted: %s", error)
        began_ns, since, pause = time.time_ns(), time.monotonic(), self._limits.retry
        while not self._end.wait(pause):
            pause = min(2 * pause, self._limits.longest_retry)
            if self._writer.has_room() and self._is_flushed():
                break
        else:
            self._writer.flush()
        self._error = ""
        seconds = time.monotonic() - since
        lost = _lost_meanwhile(self._queue.take_drops())
        _log.warning("recording resumed after %.1f s, %s", seconds, lost or "no data lost")
        self._resumed.append(
            RecordingInterrupted(
                stamp_ns=began_ns,
                reason=str(error),
                lasted_ns=round(seconds * 1e9),
                lost=lost,
            )
        )

    def _is_flushed(self) -> bool:
        try:
            self._writer.flush()
        except WriteFailedError:
            return False
        return True

    def _channel(self, topic: Topic) -> int | None:
        """Announce a topic with its first message; None when its type cannot be recorded."""
        channel = self._channels.get(topic)
        if channel is None and topic.type_name not in self._undefined:
            try:
                channel = self._channels[topic] = self._writer.register(topic)
            except SchemaNotFoundError as error:
                self._undefined.add(topic.type_name)
                _log.error("messages of this type are not recorded: %s", error)
        return channel

    def _stop(self, error: str) -> None:
        self._error = error
        self._queue.close()
        waiting = self._queue.take().events
        self._writer.abandon()
        handed = self._handed + self.topic_requests.messages
        self._lost += (
            len(waiting) + len(self._held) + self._unwritten + handed - self._writer.messages
        )
        _log.error("the recording stopped: %s", error)


def _drop_report(drops: Drops) -> LogRecord:
    return LogRecord(
        stamp_ns=time.time_ns(),
        level=WARN,
        name=_LOGGER,
        message=f"not recorded, as they came faster than they could be written: {drops}",
    )


def _lost_meanwhile(drops: Drops) -> str:
    if not drops:
        return ""
    since, until = (_time_of_day(stamp) for stamp in (drops.since_ns, drops.until_ns))
    return f"lost from {since} to {until}: {drops}"


def _time_of_day(stamp_ns: int) -> str:
    return f"{datetime.fromtimestamp(stamp_ns / 1e9).astimezone():%H:%M:%S}"


def _unconvertible(received: int, event: object, error: Exception) -> LogRecord:
    return LogRecord(
        stamp_ns=received,
        level=ERROR,
        name=_LOGGER,
        message=f"cannot record this event ({type(error).__name__}: {error}): {event!r}",
    )
