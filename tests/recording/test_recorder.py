from __future__ import annotations

import errno
import logging
import os
import threading
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest

from play_launch.core.events import (
    ComponentEvent,
    ComponentEventKind,
    ContainerState,
    ContainerStateChanged,
    LogRecord,
    NodeState,
    NodeStateChanged,
    OutputLine,
    ProcessEvent,
    ProcessEventKind,
    RunEvent,
    Stream,
)
from play_launch.core.node_key import NodeKey
from play_launch.recording.bag import McapBagWriter
from play_launch.recording.errors import WriteFailedError
from play_launch.recording.log_handler import EventLogHandler
from play_launch.recording.recorder import Recorder, RecorderLimits
from play_launch.recording.topics import LOG_ALL, OUTPUT
from tests.recording.reading import messages, raw_messages

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.recording.topics import Topic

NEVER = 1e6


def line(number: int, process: str = "/a", text: str = "") -> OutputLine:
    return OutputLine(
        stamp_ns=number, process=process, pid=1, stream=Stream.STDOUT, text=text or f"line {number}"
    )


def record(number: int, level: int = 20) -> LogRecord:
    return LogRecord(stamp_ns=number, level=level, name="n", message=f"record {number}")


class StubWriter:
    """A bag in memory; ``gate`` holds it up, ``fail_after`` makes it fail."""

    def __init__(self, *, fail_after: int = -1) -> None:
        self.path = Path("stub.mcap.active")
        self.bytes_written = 0
        self.messages = 0
        self.fail_after = fail_after
        self.topics: list[Topic] = []
        self.written: list[tuple[str, bytes, int, int]] = []
        self.flushes: list[int] = []
        self.flushed = threading.Semaphore(0)
        self.gate = threading.Event()
        self.gate.set()
        self.entered = threading.Event()
        self.closed = self.abandoned = False

    def register(self, topic: Topic) -> int:
        self.topics.append(topic)
        return len(self.topics) - 1

    def write(self, channel: int, data: bytes, *, log_time: int, publish_time: int) -> None:
        self.entered.set()
        self.gate.wait()
        if len(self.written) == self.fail_after:
            raise WriteFailedError(self.path, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
        self.written.append((self.topics[channel].name, data, log_time, publish_time))

    def attach(self, name: str, media_type: str, data: bytes, *, time: int) -> None:
        raise NotImplementedError

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        raise NotImplementedError

    def flush(self) -> None:
        self.messages = len(self.written)
        self.flushes.append(self.messages)
        self.flushed.release()

    def close(self) -> None:
        self.flush()
        self.closed = True

    def abandon(self) -> None:
        self.abandoned = True

    def texts(self, topic: Topic) -> list[bytes]:
        return [data for name, data, _, _ in self.written if name == topic.name]


def fail_test(message: str) -> None:
    pytest.fail(f"the recording stopped: {message}")


def test_every_event_is_read_back_by_rosbags(tmp_path: Path) -> None:
    events: list[RunEvent] = [
        ProcessEvent(
            stamp_ns=1, kind=ProcessEventKind.STARTED, name="/c", pid=5, command=("a", "b")
        ),
        ContainerStateChanged(stamp_ns=2, container="/c", state=ContainerState.RUNNING),
        ComponentEvent(
            stamp_ns=3,
            kind=ComponentEventKind.LOADED,
            container="/c",
            unique_id=1,
            attempt=1,
            full_node_name="/n",
            package_name="p",
            plugin_name="p::N",
            backtrace=("f", "g"),
        ),
        NodeStateChanged(stamp_ns=4, key=NodeKey("/c", "/n"), state=NodeState.LOADED),
        line(5),
        record(6),
        record(7, level=40),
    ]
    recorder = Recorder(McapBagWriter(tmp_path / "x.mcap"), on_failure=fail_test)
    for event in events:
        recorder.publish(event)
    summary = recorder.close()

    assert summary == recorder.close()
    assert (summary.path, summary.messages) == (tmp_path / "x.mcap", 8)
    assert (summary.dropped, summary.error) == (0, "")
    assert summary.bytes == summary.path.stat().st_size
    found = messages(summary.path)
    assert [(read.topic, read.type_name.rpartition("/")[2]) for read in found] == [
        ("/play_launch/states", "StateEvent"),
        ("/play_launch/states", "StateEvent"),
        ("/play_launch/events", "ComponentEvent"),
        ("/play_launch/states", "StateEvent"),
        ("/play_launch/output", "Log"),
        ("/play_launch/log/all", "Log"),
        ("/play_launch/log/all", "Log"),
        ("/play_launch/log", "Log"),
    ]
    assert [read.message.stamp.nanosec for read in found] == [1, 2, 3, 4, 5, 6, 7, 7]
    assert found[0].message.command == ["a", "b"]
    assert found[2].message.plugin_name == "p::N"
    assert found[2].message.backtrace == ["f", "g"]
    assert found[4].message.msg == "line 5"
    assert [read.log_time for read in found] == sorted(read.log_time for read in found)
    published = raw_messages(summary.path, OUTPUT.name)[0]
    assert published.publish_time == 5
    assert published.log_time > 10**18


def test_a_failure_reaches_the_file_at_once_and_other_events_by_themselves() -> None:
    writer = StubWriter()
    limits = RecorderLimits(batch=NEVER, flush=NEVER)
    recorder = Recorder(writer, on_failure=fail_test, limits=limits)
    recorder.publish(line(1))
    recorder.publish(record(2, level=40))
    writer.flushed.acquire()
    assert writer.flushes == [3]
    recorder.close()

    writer = StubWriter()
    limits = RecorderLimits(batch=0, flush=0.001)
    recorder = Recorder(writer, on_failure=fail_test, limits=limits)
    recorder.publish(line(1))
    writer.flushed.acquire()
    assert writer.flushes == [1]
    recorder.close()


def test_a_line_with_an_error_ends_the_chunk_too() -> None:
    writer = StubWriter()
    limits = RecorderLimits(batch=0, flush=NEVER)
    recorder = Recorder(writer, on_failure=fail_test, limits=limits)
    recorder.publish(line(1, text="[ERROR] [1.0] [a]: oh"))
    writer.flushed.acquire()
    assert writer.flushes == [1]
    recorder.close()


def test_too_many_lines_are_dropped_counted_and_told() -> None:
    writer = StubWriter()
    writer.gate.clear()
    limits = RecorderLimits(lines=10, other_events=5, batch=0)
    recorder = Recorder(writer, on_failure=fail_test, limits=limits)
    recorder.publish(line(0))
    writer.entered.wait()
    for number in range(1, 31):
        recorder.publish(line(number, process="/loud"))
    for number in range(31, 41):
        recorder.publish(record(number))
    assert recorder.dropped == 20 + 5
    writer.gate.set()
    summary = recorder.close()

    assert summary.dropped == 25
    assert summary.messages == len(writer.written)
    assert len(writer.texts(OUTPUT)) == 1 + 10
    *kept, report = writer.texts(LOG_ALL)
    assert len(kept) == 5
    assert b"20 lines of output (/loud 20) and 5 other events" in report


def test_long_lines_count_by_their_length() -> None:
    writer = StubWriter()
    writer.gate.clear()
    limits = RecorderLimits(text=100, batch=0)
    recorder = Recorder(writer, on_failure=fail_test, limits=limits)
    recorder.publish(line(0))
    writer.entered.wait()
    for number in range(1, 5):
        recorder.publish(line(number, text="x" * 60))
    assert recorder.dropped == 2
    writer.gate.set()
    recorder.close()


def test_a_full_disk_stops_the_recording_with_one_message_and_nothing_else() -> None:
    told: list[str] = []
    stopped = threading.Event()

    def on_failure(message: str) -> None:
        told.append(message)
        stopped.set()

    writer = StubWriter(fail_after=3)
    recorder = Recorder(writer, on_failure=on_failure, limits=RecorderLimits(batch=0))
    for number in range(10):
        recorder.publish(line(number))
    stopped.wait()
    for number in range(10, 1000):
        recorder.publish(line(number))
    summary = recorder.close()

    assert told == [summary.error]
    assert "No space left on device" in summary.error
    assert "--log-dir" in summary.error
    # The three that the writer took were not flushed.
    assert (summary.messages, summary.dropped) == (0, 1000)
    assert writer.abandoned
    assert not writer.closed
    assert summary.path.name.endswith(".active")


def test_a_disk_that_never_answers_does_not_hang_the_end() -> None:
    writer = StubWriter()
    writer.gate.clear()
    recorder = Recorder(
        writer, on_failure=lambda _: None, limits=RecorderLimits(batch=0, close=0.01)
    )
    recorder.publish(line(1))
    writer.entered.wait()
    summary = recorder.close()
    assert "took no data" in summary.error
    writer.gate.set()


def test_an_event_that_cannot_be_converted_is_named_and_the_rest_goes_on(tmp_path: Path) -> None:
    recorder = Recorder(McapBagWriter(tmp_path / "x.mcap"), on_failure=fail_test)
    recorder.publish(
        ProcessEvent(stamp_ns=1, kind=ProcessEventKind.STARTED, name="/odd", pid=cast("int", "x"))
    )
    recorder.publish(record(2))
    summary = recorder.close()
    assert (summary.dropped, summary.messages) == (1, 3)
    texts = [read.message.msg for read in messages(summary.path) if read.topic == LOG_ALL.name]
    assert "/odd" in texts[0]
    assert texts[1] == "record 2"


def test_events_after_the_end_are_counted_as_dropped(tmp_path: Path) -> None:
    recorder = Recorder(McapBagWriter(tmp_path / "x.mcap"), on_failure=fail_test)
    recorder.close()
    recorder.publish(record(1))
    assert recorder.dropped == 1


def test_many_threads_may_publish(tmp_path: Path) -> None:
    recorder = Recorder(McapBagWriter(tmp_path / "x.mcap"), on_failure=fail_test)

    def publish(process: str) -> None:
        for number in range(500):
            recorder.publish(line(number, process))

    threads = [threading.Thread(target=publish, args=(f"/p{index}",)) for index in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    summary = recorder.close()
    assert summary.messages + summary.dropped == 2000
    assert summary.dropped == 0
    seen: dict[str, list[int]] = {}
    for read in messages(summary.path):
        seen.setdefault(read.message.name, []).append(read.message.stamp.nanosec)
    assert all(numbers == list(range(500)) for numbers in seen.values())
    assert len(seen) == 4


def test_the_supervisors_log_becomes_events() -> None:
    events: list[LogRecord] = []
    logger = logging.getLogger("test_recorder.own")
    logger.propagate = False
    logger.setLevel(logging.DEBUG)
    handler = EventLogHandler(events.append)
    logger.addHandler(handler)
    try:
        logger.warning("node %s is slow", "/n")
        logger.log(25, "between")
        try:
            int("cause")
        except ValueError:
            logger.exception("broken")
    finally:
        logger.removeHandler(handler)
    assert [(event.level, event.message) for event in events[:2]] == [
        (30, "node /n is slow"),
        (20, "between"),
    ]
    assert events[0].file == "test_recorder.py"
    assert events[0].function == "test_the_supervisors_log_becomes_events"
    assert events[0].line > 0
    assert events[2].message.startswith("broken\nTraceback")
    assert "ValueError: invalid literal" in events[2].message
