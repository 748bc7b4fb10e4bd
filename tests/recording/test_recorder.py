from __future__ import annotations

import errno
import logging
import os
import re
import threading
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest

from play_launch.config.node_key import NodeKey
from play_launch.recording.bag import McapBagWriter
from play_launch.recording.errors import SchemaNotFoundError, WriteFailedError
from play_launch.recording.log_handler import EventLogHandler
from play_launch.recording.recorder import Recorder, RecorderLimits
from play_launch.recording.topics import LOG_ALL, OUTPUT
from play_launch.supervisor.events import (
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
    ProcessSample,
    RunEvent,
    Stream,
    SubjectKind,
)
from tests.recording.reading import messages, raw_messages

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.recording.chunk import TopicChunk
    from play_launch.recording.topics import Topic

NEVER = 1e6


def line(number: int, process: str = "/a", text: str = "") -> OutputLine:
    return OutputLine(
        stamp_ns=number, process=process, pid=1, stream=Stream.STDOUT, text=text or f"line {number}"
    )


def record(number: int, level: int = 20) -> LogRecord:
    return LogRecord(stamp_ns=number, level=level, name="n", message=f"record {number}")


def sample(name: str) -> ProcessSample:
    values = dict.fromkeys(ProcessSample.__annotations__, 0)
    return ProcessSample(**{**values, "key": name, "kind": SubjectKind.PROCESS})  # type: ignore[arg-type]


class StubWriter:
    """A bag in memory; ``gate`` holds it up; it is full after ``fail_after`` messages."""

    parts = 1

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
        self.asked = threading.Semaphore(0)
        self.closed = self.abandoned = False

    def register(self, topic: Topic) -> int:
        self.topics.append(topic)
        return len(self.topics) - 1

    def write(
        self, channel: int, data: bytes, *, log_time: int, publish_time: int, key: str = ""
    ) -> None:
        self.entered.set()
        self.gate.wait()
        self.written.append((self.topics[channel].name, data, log_time, publish_time))
        self._fail_when_full()

    def append_chunk(self, chunk: TopicChunk) -> None:
        raise NotImplementedError

    def latest(self, channel: int, key: str) -> bytes | None:
        raise NotImplementedError

    def attach(self, name: str, media_type: str, data: bytes, *, time: int) -> None:
        raise NotImplementedError

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        raise NotImplementedError

    def has_room(self) -> bool:
        self.asked.release()
        return not self._is_full()

    def _is_full(self) -> bool:
        return 0 <= self.fail_after < len(self.written)

    def _fail_when_full(self) -> None:
        if self._is_full():
            raise WriteFailedError(self.path, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))

    def flush(self) -> None:
        self._fail_when_full()
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
    recorder = Recorder(McapBagWriter(tmp_path / "x.mcap"))
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
    recorder = Recorder(writer, limits=limits)
    recorder.publish(line(1))
    recorder.publish(record(2, level=40))
    writer.flushed.acquire()
    assert writer.flushes == [3]
    recorder.close()

    writer = StubWriter()
    limits = RecorderLimits(batch=0, flush=0.001)
    recorder = Recorder(writer, limits=limits)
    recorder.publish(line(1))
    writer.flushed.acquire()
    assert writer.flushes == [1]
    recorder.close()


def test_a_line_with_an_error_ends_the_chunk_too() -> None:
    writer = StubWriter()
    limits = RecorderLimits(batch=0, flush=NEVER)
    recorder = Recorder(writer, limits=limits)
    recorder.publish(line(1, text="[ERROR] [1.0] [a]: oh"))
    writer.flushed.acquire()
    assert writer.flushes == [1]
    recorder.close()


def test_too_many_lines_are_dropped_counted_and_told() -> None:
    writer = StubWriter()
    writer.gate.clear()
    limits = RecorderLimits(lines=10, other_events=5, batch=0)
    recorder = Recorder(writer, limits=limits)
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


def test_samples_do_not_drive_out_what_happened() -> None:
    writer = StubWriter()
    writer.gate.clear()
    recorder = Recorder(writer, limits=RecorderLimits(lines=10, other_events=5, batch=0))
    recorder.publish(line(0))
    writer.entered.wait()
    for _ in range(30):
        recorder.publish(sample("/a"))
    assert recorder.dropped == 20
    for number in range(5):
        recorder.publish(record(number))
    assert recorder.dropped == 20
    writer.gate.set()
    recorder.close()
    assert len(writer.texts(LOG_ALL)) == 5 + 1
    assert b"20 other events" in writer.texts(LOG_ALL)[-1]


def test_long_lines_count_by_their_length() -> None:
    writer = StubWriter()
    writer.gate.clear()
    limits = RecorderLimits(text=100, batch=0)
    recorder = Recorder(writer, limits=limits)
    recorder.publish(line(0))
    writer.entered.wait()
    for number in range(1, 5):
        recorder.publish(line(number, text="x" * 60))
    assert recorder.dropped == 2
    writer.gate.set()
    recorder.close()


IMPATIENT = RecorderLimits(batch=0, retry=0.001, longest_retry=0.002)


def test_a_recording_goes_on_when_a_full_disk_has_room_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    writer = StubWriter(fail_after=3)
    recorder = Recorder(writer, limits=IMPATIENT)
    for number in range(10):
        recorder.publish(line(number))
    writer.asked.acquire()
    writer.asked.acquire()
    assert "No space left on device" in recorder.error
    for number in range(10, 20):
        recorder.publish(line(number))
    writer.fail_after = -1
    writer.flushed.acquire()
    summary = recorder.close()

    # The interruption is an event of its own.
    assert (summary.messages, summary.dropped, summary.interruptions) == (21, 0, 1)
    assert (summary.error, writer.closed, writer.abandoned) == ("", True, False)
    interrupted, goes_on = (record.getMessage() for record in caplog.records)
    assert "--log-dir" in interrupted
    assert goes_on.endswith("no data lost")


def test_what_a_full_disk_lost_is_said(caplog: pytest.LogCaptureFixture) -> None:
    writer = StubWriter(fail_after=0)
    limits = RecorderLimits(batch=0, retry=0.001, longest_retry=0.002, lines=10, other_events=5)
    recorder = Recorder(writer, limits=limits)
    recorder.publish(line(0))
    writer.asked.acquire()
    for number in range(1, 31):
        recorder.publish(line(number, process="/loud"))
    recorder.publish(record(31))
    writer.fail_after = -1
    writer.flushed.acquire()
    summary = recorder.close()

    assert (summary.messages, summary.dropped) == (13, 20)
    goes_on = caplog.records[-1].getMessage()
    assert re.search(r"lost from [\d:]{8} to [\d:]{8}: 20 lines of output \(/loud 20\)$", goes_on)


def test_a_disk_that_stays_full_leaves_the_run_alone(caplog: pytest.LogCaptureFixture) -> None:
    writer = StubWriter(fail_after=3)
    recorder = Recorder(writer, limits=IMPATIENT)
    for number in range(10):
        recorder.publish(line(number))
    writer.asked.acquire()
    summary = recorder.close()
    for number in range(10, 1000):
        recorder.publish(line(number))

    assert "No space left on device" in summary.error
    assert "--log-dir" in summary.error
    # Those that the writer took were not flushed.
    assert (summary.messages, summary.dropped, recorder.dropped) == (0, 10, 1000)
    assert writer.abandoned
    assert not writer.closed
    assert summary.path.name.endswith(".active")
    assert ["interrupted" in one.getMessage() for one in caplog.records] == [True, False]


def test_a_disk_that_never_answers_does_not_hang_the_end() -> None:
    writer = StubWriter()
    writer.gate.clear()
    recorder = Recorder(writer, limits=RecorderLimits(batch=0, close=0.01))
    recorder.publish(line(1))
    writer.entered.wait()
    summary = recorder.close()
    assert "took no data" in summary.error
    writer.gate.set()


def test_an_event_that_cannot_be_converted_is_named_and_the_rest_goes_on(tmp_path: Path) -> None:
    recorder = Recorder(McapBagWriter(tmp_path / "x.mcap"))
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
    recorder = Recorder(McapBagWriter(tmp_path / "x.mcap"))
    recorder.close()
    recorder.publish(record(1))
    assert recorder.dropped == 1


def test_many_threads_may_publish(tmp_path: Path) -> None:
    recorder = Recorder(McapBagWriter(tmp_path / "x.mcap"))

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


def test_a_type_that_is_not_installed_is_reported_once_and_the_rest_recorded(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class WithoutSamples(StubWriter):
        def register(self, topic: Topic) -> int:
            if topic.about is not None:
                raise SchemaNotFoundError(topic.type_name, (Path("/opt"),))
            return super().register(topic)

    writer = WithoutSamples()
    recorder = Recorder(writer)
    for name in ("/a", "/b", "/a"):
        recorder.publish(sample(name))
    recorder.publish(record(1))
    summary = recorder.close()
    assert (summary.dropped, summary.error) == (3, "")
    assert len(writer.texts(LOG_ALL)) == 1
    (message,) = [each.getMessage() for each in caplog.records if each.levelname == "ERROR"]
    assert "play_launch_msgs/msg/ProcessStats not found below /opt" in message
