"""What was synced survives the loss of everything else, and a slow disk delays no event."""

from __future__ import annotations

import errno
import os
import shutil
import threading
import time
from pathlib import Path

import pytest
import yaml

from play_launch.config.model import RotateConfig
from play_launch.container.cdr.messages import log_message
from play_launch.postmortem.bag_reader import BagReader
from play_launch.recording.bag import BagWriter
from play_launch.recording.errors import WriteFailedError
from play_launch.recording.limits import RecorderLimits
from play_launch.recording.recorder import Recorder
from play_launch.recording.topics import OUTPUT
from play_launch.supervisor.events import OutputLine, Stream


def line(number: int) -> OutputLine:
    return OutputLine(
        stamp_ns=number, process="/a", pid=1, stream=Stream.STDOUT, text=f"line {number}"
    )


class SlowDisk:
    """Stands for ``os.fdatasync``: waits, and remembers how much of the file there was."""

    def __init__(self) -> None:
        self.sizes: list[int] = []
        self.begun = threading.Semaphore(0)
        self.gate = threading.Event()

    def __call__(self, descriptor: int) -> None:
        self.sizes.append(os.fstat(descriptor).st_size)
        self.begun.release()
        self.gate.wait()


@pytest.fixture
def slow_disk(monkeypatch: pytest.MonkeyPatch) -> SlowDisk:
    disk = SlowDisk()
    monkeypatch.setattr(os, "fdatasync", disk)
    return disk


def test_what_is_on_the_disk_after_a_sync_is_readable(tmp_path: Path, slow_disk: SlowDisk) -> None:
    slow_disk.gate.set()
    writer = BagWriter(tmp_path / "x.mcap", sync=1e-3)
    channel = writer.register(OUTPUT)
    flushed: list[int] = []
    for number in range(20):
        for repeated in range(number + 1):
            data = log_message(repeated, 20, "/a", f"line {number}", file="stdout")
            writer.write(channel, data, log_time=number + 1, publish_time=number)
        writer.flush()
        flushed.append(writer.bytes_written)
        if number % 5 == 0:
            slow_disk.begun.acquire()
    writer.abandon()
    whole = writer.path.read_bytes()
    assert slow_disk.sizes
    for size in slow_disk.sizes:
        assert size in {0, *flushed}, "only what was flushed as a whole is synced"
        copy = tmp_path / "copy.mcap"
        copy.write_bytes(whole[:size])
        reader = BagReader(copy)
        flushes = flushed.index(size) + 1
        assert sum(1 for _ in reader.messages()) == flushes * (flushes + 1) // 2
        assert reader.damages == []


def test_a_sync_that_takes_long_holds_up_no_line(tmp_path: Path, slow_disk: SlowDisk) -> None:
    writer = BagWriter(tmp_path / "x.mcap", sync=1e-3)
    recorder = Recorder(writer, limits=RecorderLimits(batch=0, flush=0, lines=100))
    recorder.publish(line(0))
    slow_disk.begun.acquire()
    for number in range(1, 1000):
        recorder.publish(line(number))
        while number % 100 == 0 and writer.messages < number - 50:
            time.sleep(0)  # the recorder's thread, not the disk's, is given its time
    slow_disk.gate.set()
    summary = recorder.close()
    assert (summary.messages, summary.dropped) == (1000, 0)


def test_it_is_synced_at_intervals_and_not_when_nothing_is_new(
    tmp_path: Path, slow_disk: SlowDisk
) -> None:
    slow_disk.gate.set()
    writer = BagWriter(tmp_path / "x.mcap", sync=1e6)
    writer.register(OUTPUT)
    writer.flush()
    writer.flush()
    assert slow_disk.sizes == []
    writer.close()
    assert len(slow_disk.sizes) == 1, "a file that is complete is forced to the disk"


def test_another_file_begins_while_the_last_one_is_forced_to_the_disk(
    tmp_path: Path, slow_disk: SlowDisk
) -> None:
    writer = BagWriter(tmp_path / "x.mcap", rotation=RotateConfig(size=1))
    channel = writer.register(OUTPUT)
    writer.write(channel, b"\0\1\0\0", log_time=1, publish_time=1)
    writer.flush()
    slow_disk.begun.acquire()
    writer.write(channel, b"\0\1\0\0", log_time=2, publish_time=2)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["x.mcap.active", "x_1.mcap.active"]
    slow_disk.gate.set()
    writer.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x.mcap", "x_1.mcap"]


def test_what_waits_for_the_disk_does_not_become_more_with_each_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, permits = threading.Semaphore(0), threading.Semaphore(0)
    synced: list[int] = []

    def sync(descriptor: int) -> None:
        begun.release()
        permits.acquire()
        synced.append(descriptor)

    monkeypatch.setattr(os, "fdatasync", sync)
    writer = BagWriter(tmp_path / "x.mcap", rotation=RotateConfig(size=100_000), sync=1e-3)
    channel = writer.register(OUTPUT)

    def flush(size: int) -> None:
        data = log_message(1, 20, "/a", os.urandom(size).hex(), file="stdout")
        writer.write(channel, data, log_time=1, publish_time=1)
        writer.flush()

    flush(1)
    begun.acquire()  # the first one of the first file: what comes is not in it
    flush(100_000)
    assert writer.parts == 2
    permits.release()
    begun.acquire()  # the second one of the first file; one of the second file is to come
    flush(1)
    flush(100_000)
    assert writer.parts == 3
    permits.release(100)
    while not (tmp_path / "x_1.mcap").exists():
        time.sleep(0)
    # Of the first file two and that of its end, of the second one and that of its end; of the
    # third one what there was time for.
    assert [synced.count(each) for each in dict.fromkeys(synced)][:2] == [3, 2]
    writer.close()


def test_a_file_that_is_removed_is_reported_once(
    tmp_path: Path, slow_disk: SlowDisk, caplog: pytest.LogCaptureFixture
) -> None:
    slow_disk.gate.set()
    (tmp_path / "session").mkdir()
    writer = BagWriter(tmp_path / "session" / "x.mcap", sync=1e-3)
    channel = writer.register(OUTPUT)
    for number in (1, 2, 3):
        writer.write(channel, b"\0\1\0\0", log_time=number, publish_time=number)
        writer.flush()
        slow_disk.begun.acquire()
        shutil.rmtree(tmp_path / "session", ignore_errors=True)
    with pytest.raises(WriteFailedError, match="or its folder, was removed"):
        writer.close()
    writer.abandon()
    (error,) = caplog.records
    assert "x.mcap.active was removed" in error.getMessage()


def test_a_file_before_that_cannot_be_completed_is_reported_at_once_and_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    syncs = threading.Semaphore(0)
    really = os.fdatasync

    def fail_first(descriptor: int) -> None:
        first = Path(f"/proc/self/fd/{descriptor}").readlink().name == "session.mcap.active"
        syncs.release()
        if first:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        really(descriptor)

    monkeypatch.setattr(os, "fdatasync", fail_first)
    writer = BagWriter(tmp_path / "session.mcap", rotation=RotateConfig(size=1), has_index=True)
    channel = writer.register(OUTPUT)
    for number in (1, 2, 3):
        writer.write(channel, b"\0\1\0\0", log_time=number, publish_time=number)
        writer.flush()
        assert syncs.acquire(timeout=10)
    (error,) = caplog.records
    assert "/session.mcap.active cannot be" in error.getMessage(), "hours before the end"
    with pytest.raises(WriteFailedError, match=r"/session\.mcap\.active: Input/output error"):
        writer.close()
    writer.abandon()
    assert len(caplog.records) == 1
    index = yaml.safe_load((tmp_path / "metadata.yaml").read_text())
    listed = index["rosbag2_bagfile_information"]["relative_file_paths"]
    assert listed == ["session_1.mcap", "session_2.mcap", "session_3.mcap"]
    assert all((tmp_path / name).is_file() for name in listed)
