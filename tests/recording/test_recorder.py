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
from play_launch.container.cdr.messages import LOG
from play_launch.recording import decisions
from play_launch.recording.bag import BagWriter
from play_launch.recording.decisions import DecisionLog
from play_launch.recording.errors import SchemaNotFoundError, WriteFailedError
from play_launch.recording.limits import RecorderLimits
from play_launch.recording.log_handler import EventLogHandler
from play_launch.recording.recorder import Recorder
from play_launch.recording.topics import INPUTS, LOG_ALL, OUTPUT, PROCESS_STATS, message_definition
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
from play_launch.supervisor.inputs import Time
from tests.recording.reading import messages, raw_messages

if TYPE_CHECKING:
    from play_launch.recording.limits import RecordingSummary
    from play_launch.recording.topics import Topic

NEVER = 1e6


def line(number: int, process: str = "/a", text: str = "") -> OutputLine:
    return OutputLine(
        stamp_ns=number, process=process, pid=1, stream=Stream.STDOUT, text=text or f"line {number}"
    )


def record(number: int, level: int = 20) -> LogRecord:
    return LogRecord(stamp_ns=number, level=level, name="n", message=f"record {number}")


def sample(name: str) -> ProcessSample:
    values = dict.fromkeys(ProcessSample.__struct_fields__, 0)
    return ProcessSample(**{**values, "key": name, "kind": SubjectKind.PROCESS})  # type: ignore[arg-type]


class GatedBag(BagWriter):
    """A bag with a gate before each write, on a disk that can be full."""

    def __init__(self, path: Path) -> None:
        super().__init__(path / "x.mcap")
        self.is_full = False
        self.gate, self.entered = threading.Event(), threading.Event()
        self.gate.set()
        self.flushed, self.asked = threading.Semaphore(0), threading.Semaphore(0)

    def write(
        self, channel: int, data: bytes, *, log_time: int, publish_time: int, key: str = ""
    ) -> None:
        self.entered.set()
        self.gate.wait()
        super().write(channel, data, log_time=log_time, publish_time=publish_time, key=key)

    def flush(self) -> None:
        if self.is_full:
            raise WriteFailedError(self.path, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
        super().flush()
        self.flushed.release()

    def has_room(self) -> bool:
        self.asked.release()
        return not self.is_full

    def abandon(self) -> None:
        super().abandon()
        self.gate.set()


@pytest.fixture
def bag(tmp_path: Path) -> GatedBag:
    return GatedBag(tmp_path)


def texts(summary: RecordingSummary, topic: Topic) -> list[str]:
    return [LOG.read(each.data)["msg"] for each in raw_messages(summary.path, topic.name)]


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
    recorder = Recorder(BagWriter(tmp_path / "x.mcap"))
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


@pytest.mark.parametrize(
    ("limits", "event"),
    [
        (RecorderLimits(batch=NEVER, flush=NEVER), record(2, level=40)),
        (RecorderLimits(batch=0, flush=NEVER), line(2, text="[ERROR] [1.0] [a]: oh")),
        (RecorderLimits(batch=0, flush=0.001), line(2)),
    ],
    ids=["a failure at once", "an error in the output", "anything else soon"],
)
def test_events_reach_the_file(bag: GatedBag, limits: RecorderLimits, event: RunEvent) -> None:
    recorder = Recorder(bag, limits=limits)
    recorder.publish(line(1))
    recorder.publish(event)
    while bag.messages < 2:
        assert bag.flushed.acquire(timeout=10)
    recorder.close()


def test_too_many_events_are_dropped_counted_and_reported(bag: GatedBag) -> None:
    bag.gate.clear()
    recorder = Recorder(bag, limits=RecorderLimits(lines=10, other_events=5, batch=0))
    recorder.publish(line(0))
    bag.entered.wait()
    for _ in range(10):
        recorder.publish(sample("/a"))
    for number in range(1, 31):
        recorder.publish(line(number, process="/loud"))
        recorder.publish(sample("/a"))
    assert recorder.dropped == 60
    for number in range(31, 41):
        recorder.publish(record(number))
    assert recorder.dropped == 60 + 5, "lines and samples drive out nothing else"
    bag.gate.set()
    summary = recorder.close()
    assert summary.dropped == 65
    assert texts(summary, OUTPUT) == ["line 0"]
    *kept, report = texts(summary, LOG_ALL)
    assert len(kept) == 5
    assert "dropped 30 lines of output (/loud 30) and 35 other events: " in report


def test_long_lines_count_by_their_length(bag: GatedBag) -> None:
    bag.gate.clear()
    recorder = Recorder(bag, limits=RecorderLimits(text=130, batch=0))
    recorder.publish(line(0))
    bag.entered.wait()
    for number in range(1, 5):
        recorder.publish(line(number, text="x" * 60))
    recorder.publish(line(5, text="short"))
    assert recorder.dropped == 2
    bag.gate.set()
    recorder.close()


IMPATIENT = RecorderLimits(batch=0, retry=0.001, longest_retry=0.002, lines=10, other_events=5)


def test_losses_on_a_full_disk_are_logged(bag: GatedBag, caplog: pytest.LogCaptureFixture) -> None:
    bag.is_full = True
    recorder = Recorder(bag, limits=IMPATIENT)
    recorder.publish(line(0))
    assert bag.asked.acquire(timeout=10)
    for number in range(1, 31):
        recorder.publish(line(number, process="/loud"))
    bag.is_full = False
    assert bag.flushed.acquire(timeout=10)
    summary = recorder.close()
    assert (summary.messages, summary.dropped) == (12, 20)
    interrupted, resumed = (each.getMessage() for each in caplog.records)
    assert "--log-dir" in interrupted
    assert re.search(r"lost from [\d:]{8} to [\d:]{8}: 20 lines of output \(/loud 20\)$", resumed)


def test_inputs_that_find_no_room_are_counted_and_leave_a_gap(bag: GatedBag) -> None:
    bag.gate.clear()
    recorder = Recorder(bag, limits=RecorderLimits(lines=1, other_events=1, batch=0))
    log = DecisionLog(recorder.publish)
    recorder.publish(line(0))
    bag.entered.wait()
    for _ in range(3):
        log.add(1.0, Time())
    bag.gate.set()
    while recorder.waiting:
        os.sched_yield()
    log.add(1.0, Time())
    summary = recorder.close()
    found = raw_messages(summary.path, INPUTS.name)
    numbers = [each.number for message in found for each in decisions.read(message.data)]
    assert numbers == [0, 1, 3]
    assert summary.dropped == 1


def test_a_disk_that_never_answers_does_not_hang_the_end(bag: GatedBag) -> None:
    bag.gate.clear()
    recorder = Recorder(bag, limits=RecorderLimits(batch=0, close=0.01))
    recorder.publish(line(1))
    bag.entered.wait()
    summary = recorder.close()
    assert "took no data" in summary.error
    bag.gate.set()


def test_an_event_that_cannot_be_converted_is_named_and_the_rest_goes_on(tmp_path: Path) -> None:
    recorder = Recorder(BagWriter(tmp_path / "x.mcap"))
    recorder.publish(
        ProcessEvent(stamp_ns=1, kind=ProcessEventKind.STARTED, name="/odd", pid=cast("int", "x"))
    )
    recorder.publish(record(2))
    summary = recorder.close()
    assert (summary.dropped, summary.messages) == (1, 3)
    texts = [read.message.msg for read in messages(summary.path) if read.topic == LOG_ALL.name]
    assert "/odd" in texts[0]
    assert texts[1] == "record 2"


def test_many_threads_may_publish(tmp_path: Path) -> None:
    recorder = Recorder(BagWriter(tmp_path / "x.mcap"))

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
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def definition(name: str) -> str:
        if name == PROCESS_STATS:
            raise SchemaNotFoundError(f"{name} is not installed")
        return message_definition(name)

    recorder = Recorder(BagWriter(tmp_path / "x.mcap", definition=definition))
    for name in ("/a", "/b", "/a"):
        recorder.publish(sample(name))
    recorder.publish(record(1))
    summary = recorder.close()
    assert (summary.dropped, summary.error) == (3, "")
    assert texts(summary, LOG_ALL) == ["record 1"]
    (message,) = [each.getMessage() for each in caplog.records if each.levelname == "ERROR"]
    assert "play_launch_msgs/msg/ProcessStats is not installed" in message
