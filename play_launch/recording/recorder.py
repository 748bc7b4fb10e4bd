"""The flight recorder: takes the events of a run and writes them from a thread of its own."""

from __future__ import annotations

import threading
import time
from collections import Counter
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.core.events import LogRecord, OutputLine, RunEvent
from play_launch.recording import topics
from play_launch.recording.console_format import ERROR, WARN
from play_launch.recording.convert import convert, convert_output, is_failure
from play_launch.recording.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from play_launch.recording.bag import BagWriter
    from play_launch.recording.topics import Topic

_LOGGER: Final = "play_launch.recording"
_FLOOD: Final = 1000
"""Events in one batch that make it a flood: 20,000 a second."""
_NAMED_PROCESSES: Final = 5
"""How many processes a report of drops names; the rest is summed up."""


class RecorderLimits(Struct, frozen=True):
    """Sizes and times of a recorder; the defaults suit a run of a few hundred nodes."""

    lines: int = 50_000
    """Output lines waiting to be written; further ones are dropped and counted."""
    text: int = 32 * 1024 * 1024
    """Characters of output waiting to be written."""
    other_events: int = 10_000
    """Room for other events when ``lines`` is used up: a flood of output must not drive out the
    events that say what happened."""
    batch: float = 0.05
    """Seconds to gather events before they are written together."""
    flush: float = 0.15
    """Seconds that a written message may wait for the end of its chunk. Together with ``batch``
    this is what a SIGKILL can cost; it leaves 0.05 s of the promised 0.25 s to a busy machine."""
    failure_gap: float = 0.01
    """Least seconds between two chunks that end early because of a failure."""
    close: float = 10.0
    """Seconds to wait at the end for what is still to be written."""


class RecordingSummary(Struct, frozen=True):
    """What became of a recording."""

    path: Path
    """The file; it still ends in ``.active`` when it could not be completed."""
    messages: int
    """Messages that are in the file."""
    dropped: int
    """Events that are not in the file."""
    bytes: int
    error: str = ""
    """Why the recording stopped early, and the fix; empty when it is complete."""


class Recorder:
    """An :class:`~play_launch.core.events.EventSink` that records.

    :meth:`publish` may be called from any thread; it never blocks and never fails. The file
    belongs to the recorder's thread. When that cannot write any more, the recording stops,
    ``on_failure`` is called once from that thread with one sentence, and the run goes on.
    """

    def __init__(
        self,
        writer: BagWriter,
        *,
        on_failure: Callable[[str], None],
        limits: RecorderLimits | None = None,
    ) -> None:
        """Register the topics and start the thread; may raise ``RecordingError``."""
        self._writer = writer
        self._on_failure = on_failure
        self._limits = limits or RecorderLimits()
        self._channels: dict[Topic, int] = {
            topic: writer.register(topic) for topic in topics.ALL_TOPICS
        }
        self._lock = threading.Lock()
        self._queue: list[tuple[int, RunEvent]] = []
        self._text = 0
        self._not_taken: Counter[str] = Counter()
        """Drops that the recording does not report yet: lines by process, the rest under ""."""
        self._dropped = 0
        self._lost = 0
        """As ``_dropped``, but counted by the recorder's thread."""
        self._unwritten = 0
        """Events of the batch under way that the writer has not got yet."""
        self._handed = 0
        """Messages that the writer has got."""
        self._unflushed = 0
        self._error = ""
        self._stopped = False
        self._closing = False
        self._summary: RecordingSummary | None = None
        self._wake = threading.Event()
        self._hurry = threading.Event()
        # A daemon: the end of the program must not wait for a disk that never answers.
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Events that were not recorded so far."""
        return self._dropped + self._lost

    @property
    def error(self) -> str:
        """Why the recording stopped early; empty while it goes on."""
        return self._error

    def publish(self, event: RunEvent) -> None:
        """Take one event; its time of arrival becomes the ``log_time``."""
        received = time.time_ns()
        is_line = isinstance(event, OutputLine)
        with self._lock:
            if not self._has_room(event):
                self._dropped += 1
                self._not_taken[event.process if isinstance(event, OutputLine) else ""] += 1
                return
            was_empty = not self._queue
            self._queue.append((received, event))
            if isinstance(event, OutputLine):
                self._text += len(event.text)
        if not is_line and is_failure(event):
            self._hurry.set()
            self._wake.set()
        elif was_empty:
            self._wake.set()

    def close(self) -> RecordingSummary:
        """Write what is waiting, complete the file and return what became of it.

        Blocks for at most ``limits.close`` seconds. Further calls return the same summary.
        """
        if self._summary is None:
            with self._lock:
                self._closing = True
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
                error=self._error,
            )
        return self._summary

    def _has_room(self, event: RunEvent) -> bool:
        if self._stopped or self._closing:
            return False
        waiting = len(self._queue)
        if isinstance(event, OutputLine):
            return waiting < self._limits.lines and self._text < self._limits.text
        return waiting < self._limits.lines + self._limits.other_events

    def _run(self) -> None:
        try:
            self._record()
            self._writer.close()
        except RecordingError as error:
            self._stop(str(error))
        except Exception as error:  # noqa: BLE001 - the run must go on whatever fails here
            self._stop(f"the recorder failed: {type(error).__name__}: {error}")

    def _record(self) -> None:
        flush_at = 0.0
        flushed_at = 0.0
        while True:
            waiting = max(0.0, flush_at - time.monotonic()) if self._unflushed else None
            if self._wake.wait(waiting):
                if self._hurry.is_set():
                    gap = flushed_at + self._limits.failure_gap - time.monotonic()
                    if gap > 0 and not self._closing:
                        time.sleep(gap)
                else:
                    self._hurry.wait(self._limits.batch)
            hurried = self._hurry.is_set()
            self._hurry.clear()
            self._wake.clear()
            batch, drops, closing = self._take()
            if not self._unflushed:
                flush_at = time.monotonic() + self._limits.flush
            failed = self._write_batch(batch)
            if drops:
                self._write(time.time_ns(), _drop_report(drops))
            if self._unflushed and (hurried or failed or closing or time.monotonic() >= flush_at):
                self._writer.flush()
                self._unflushed = 0
                flushed_at = time.monotonic()
            if closing:
                return

    def _take(self) -> tuple[list[tuple[int, RunEvent]], Counter[str], bool]:
        with self._lock:
            batch, self._queue = self._queue, []
            self._text = 0
            drops, self._not_taken = self._not_taken, Counter()
            return batch, drops, self._closing

    def _write_batch(self, batch: list[tuple[int, RunEvent]]) -> bool:
        """Write events; return whether a line among them was an error."""
        failed = False
        # In a flood the event loop is busy as well and would in turn keep the lock for 5 ms each
        # time: then only an equal share keeps up.
        polite = len(batch) < _FLOOD
        self._unwritten = len(batch)
        output_channel = self._channels[topics.OUTPUT]
        write = self._writer.write
        for number, (received, event) in enumerate(batch):
            if isinstance(event, OutputLine):
                (_, data), level = convert_output(event)
                write(output_channel, data, log_time=received, publish_time=max(event.stamp_ns, 0))
                self._handed += 1
                self._unflushed += 1
                failed = failed or level >= ERROR
            else:
                self._write(received, event)
            self._unwritten -= 1
            if polite and not number & 63:
                # Gives up the interpreter lock; otherwise the event loop gets it back only after
                # the switch interval, 5 ms.
                time.sleep(0)
        return failed

    def _write(self, received: int, event: RunEvent) -> None:
        try:
            recorded = convert(event)
        except Exception as error:  # noqa: BLE001 - one odd event must not end the recording
            self._lost += 1
            recorded = convert(_unconvertible(received, event, error))
        for topic, data in recorded:
            self._writer.write(
                self._channels[topic],
                data,
                log_time=received,
                publish_time=max(event.stamp_ns, 0),
            )
            self._handed += 1
            self._unflushed += 1

    def _stop(self, error: str) -> None:
        self._error = error
        with self._lock:
            self._stopped = True
            self._dropped += len(self._queue)
            self._queue = []
        self._writer.abandon()
        self._lost += self._unwritten + self._handed - self._writer.messages
        self._on_failure(error)


def _drop_report(drops: Counter[str]) -> LogRecord:
    others = drops.pop("", 0)
    parts: list[str] = []
    if lines := drops.total():
        named = [f"{name} {count}" for name, count in drops.most_common(_NAMED_PROCESSES)]
        if len(drops) > _NAMED_PROCESSES:
            named.append("…")
        parts.append(f"{lines} lines of output ({', '.join(named)})")
    if others:
        parts.append(f"{others} other events")
    return LogRecord(
        stamp_ns=time.time_ns(),
        level=WARN,
        name=_LOGGER,
        message=f"not recorded, as they came faster than they could be written: "
        f"{' and '.join(parts)}",
    )


def _unconvertible(received: int, event: RunEvent, error: Exception) -> LogRecord:
    return LogRecord(
        stamp_ns=received,
        level=ERROR,
        name=_LOGGER,
        message=f"cannot record this event ({type(error).__name__}: {error}): {event!r}",
    )
