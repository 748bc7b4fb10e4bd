"""A disk that really is full interrupts the recording, and nothing else."""

from __future__ import annotations

import os
import queue
from typing import TYPE_CHECKING

import pytest

from play_launch.config.model import RecordConfig, RotateConfig
from play_launch.postmortem.bag_reader import BagReader
from play_launch.recording.errors import RecordingError
from play_launch.recording.limits import RecorderLimits
from play_launch.recording.session import Session, open_session
from play_launch.recording.topics import LOG_ALL, OUTPUT
from play_launch.supervisor.events import LogRecord, OutputLine, Stream
from tests.recording.reading import messages, raw_messages
from tests.recording.test_opening import description
from tests.recording.test_topic_chunks import chunk_of
from tests.support.mounts import disk_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

SIZE = 1024 * 1024
LIMITS = RecorderLimits(batch=0.001, flush=0.001, retry=0.005, longest_retry=0.01)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    with disk_of(str(SIZE), tmp_path / "disk") as folder:
        yield folder


def test_a_start_for_which_there_is_no_room_leaves_nothing(small_disk: Path) -> None:
    before = open_session(description(), log_folder=small_disk, limits=LIMITS)
    before.recorder.close()
    with (small_disk / "ballast").open("wb") as ballast:
        status = os.statvfs(small_disk)
        ballast.write(bytes(status.f_bavail * status.f_frsize))
    listed = sorted(small_disk.iterdir())
    with pytest.raises(RecordingError, match="No space left on device"):
        open_session(description(), log_folder=small_disk, limits=LIMITS)
    assert sorted(small_disk.iterdir()) == listed
    assert (small_disk / "latest").samefile(before.folder)


def publish(session: Session, first: int, count: int) -> None:
    for number in range(first, first + count):
        text = os.urandom(500).hex()
        session.recorder.publish(
            OutputLine(stamp_ns=number, process="/a", pid=1, stream=Stream.STDOUT, text=text)
        )


def publish_until_interrupted(session: Session) -> int:
    """Publish lines from number 0 on; return how many."""
    count = 0
    while not session.recorder.error:
        assert count < 20_000, "the disk does not get full"
        if session.recorder.waiting < 100:
            publish(session, count, 50)
            count += 50
        os.sched_yield()
    return count


def test_the_run_goes_on_and_what_was_written_stays(small_disk: Path) -> None:
    session = open_session(description(), log_folder=small_disk, limits=LIMITS)
    count = publish_until_interrupted(session)
    summary = session.recorder.close()
    assert "No space left on device" in summary.error
    assert summary.path == session.folder / "session.mcap.active"
    assert summary.interruptions >= 1
    readable = raw_messages(summary.path, OUTPUT.name)
    assert [message.publish_time for message in readable] == list(range(len(readable)))
    assert summary.messages == len(readable)
    assert summary.messages + summary.dropped == count
    reader = BagReader(summary.path)
    assert sum(1 for _ in reader.messages()) == len(readable)
    assert reader.damages == [], "it ends after a whole chunk"


def test_topics_leave_room_for_events(small_disk: Path) -> None:
    session = open_session(description(), log_folder=small_disk, limits=LIMITS)
    recorder = session.recorder
    answered = queue.SimpleQueue[int]()
    recorder.open_channel("/one", "std_msgs/msg/String", "", answered.put)
    channel = answered.get(timeout=10)
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(SIZE // 2))

    def record(count: int) -> None:
        done = queue.SimpleQueue[None]()
        for number in range(count):
            chunk = chunk_of([(channel, number + 1, bytes(20_000))])
            recorder.append_chunk(chunk, lambda: done.put(None))
        for _ in range(count):
            done.get(timeout=10)

    record(40)
    lost = recorder.topic_drops
    assert 0 < lost < 40
    publish(session, 0, 10)
    ballast.unlink()
    record(3)
    summary = recorder.close()
    assert (summary.error, summary.interruptions, summary.dropped) == ("", 0, 0)
    assert (summary.topic_drops, recorder.topic_messages) == (lost, 43 - lost)
    stamps = [each.publish_time for each in BagReader(session.folder).messages({OUTPUT.name})]
    assert stamps == list(range(10))


@pytest.mark.parametrize("rotate", [RotateConfig(), RotateConfig(size=100_000)])
def test_it_goes_on_when_there_is_room_again_without_a_gap(
    small_disk: Path, rotate: RotateConfig
) -> None:
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(SIZE - 300_000))
    session = open_session(
        description(), log_folder=small_disk, record=RecordConfig(rotate=rotate), limits=LIMITS
    )
    count = publish_until_interrupted(session)
    publish(session, count, 100)
    session.recorder.publish(LogRecord(stamp_ns=1, level=40, name="n", message="a crash"))
    ballast.unlink()
    while session.recorder.error:
        os.sched_yield()
    publish(session, count + 100, 10)
    summary = session.recorder.close()
    assert (summary.error, summary.dropped) == ("", 0)
    assert summary.interruptions >= 1
    assert (summary.parts > 1) == (rotate.size < SIZE)
    reader = BagReader(session.folder)
    stamps = [message.publish_time for message in reader.messages({OUTPUT.name})]
    assert stamps == list(range(count + 110))
    assert (reader.damages, reader.is_complete) == ([], True)
    read = messages(session.folder)
    assert "a crash" in [one.message.msg for one in read if one.topic == LOG_ALL.name]
