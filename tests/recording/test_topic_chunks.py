"""Chunks that another process has made: where they come to stand, and what becomes of failures."""

from __future__ import annotations

import errno
import os
import struct
import threading
import zlib
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from play_launch.recording.bag import McapBagWriter, Rotation
from play_launch.recording.chunk import ChannelPart, TopicChunk
from play_launch.recording.errors import WriteFailedError
from play_launch.recording.recorder import Recorder
from play_launch.recording.topics import Topic
from tests.recording.reading import raw_messages, records
from tests.recording.test_bag import write_lines

if TYPE_CHECKING:
    from pathlib import Path

LOG = "rcl_interfaces/msg/Log"


def chunk_of(messages: list[tuple[int, int, bytes]]) -> TopicChunk:
    """Make a chunk of channels, log times and data, by the book: https://mcap.dev/spec."""
    content, indexes = b"", dict[int, bytes]()
    for channel, time, data in messages:
        entry = struct.pack("<QQ", time, len(content))
        indexes[channel] = indexes.get(channel, b"") + entry
        content += struct.pack("<BQHIQQ", 5, 22 + len(data), channel, 1, time, time) + data
    times = [time for _, time, _ in messages]
    begin, end = min(times), max(times)
    head = struct.pack("<QQQIIQ", begin, end, len(content), zlib.crc32(content), 0, len(content))
    whole = struct.pack("<BQ", 6, len(head) + len(content)) + head + content
    chunk_length, parts = len(whole), []
    for channel, index in indexes.items():
        parts.append(ChannelPart(channel, len(index) // 16, len(whole)))
        whole += struct.pack("<BQHI", 7, 6 + len(index), channel, len(index)) + index
    descriptor = os.memfd_create("chunk")
    os.write(descriptor, whole)
    return TopicChunk(
        descriptor=descriptor,
        length=len(whole),
        chunk_length=chunk_length,
        records_length=len(content),
        begin=begin,
        end=end,
        parts=tuple(parts),
    )


def test_a_chunk_comes_after_what_was_written_before(tmp_path: Path) -> None:
    writer = McapBagWriter(tmp_path / "x.mcap")
    one, two = writer.register(Topic("/one", LOG)), writer.register(Topic("/two", LOG))
    write_lines(writer, one, 100, 3)
    chunk = chunk_of([(two, 90, b"abcd"), (one, 110, b"efgh"), (two, 95, b"")])
    writer.append_chunk(chunk)
    os.close(chunk.descriptor)
    assert writer.messages == 6
    write_lines(writer, two, 120, 2)
    writer.close()
    assert writer.bytes_written == writer.path.stat().st_size
    assert [each.log_time for each in raw_messages(writer.path, "/two")] == [90, 95, 120, 121]
    assert [each.data for each in raw_messages(writer.path, "/two")][:2] == [b"abcd", b""]
    with writer.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        by_index = [(each.log_time, each.channel_id) for _, _, each in reader.iter_messages()]
        summary = reader.get_summary()
    assert by_index == sorted(by_index)
    assert len(by_index) == 8
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.channel_message_counts == {one: 4, two: 4}
    assert summary.statistics.message_start_time == 90
    assert [each.compression for each in summary.chunk_indexes] == ["zstd", "", "zstd"]


def test_each_file_can_be_read_alone(tmp_path: Path) -> None:
    writer = McapBagWriter(tmp_path / "x.mcap", rotation=Rotation(size=4000))
    channel = writer.register(Topic("/one", LOG))
    for time in range(1, 9):
        chunk = chunk_of([(channel, time, bytes(1000))])
        writer.append_chunk(chunk)
        os.close(chunk.descriptor)
    writer.close()
    files = sorted(tmp_path.glob("*.mcap"))
    assert len(files) > 2
    read = [each.log_time for path in files for each in raw_messages(path, "/one")]
    assert sorted(read) == list(range(1, 9))


@given(st.integers(0, 200))
def test_a_chunk_that_is_cut_leaves_nothing(
    tmp_path_factory: pytest.TempPathFactory, cut: int
) -> None:
    path = tmp_path_factory.mktemp("bag") / "x.mcap"
    writer = McapBagWriter(path)
    channel = writer.register(Topic("/one", LOG))
    write_lines(writer, channel, 1, 1)
    chunk = chunk_of([(channel, 2, bytes(100))])
    os.ftruncate(chunk.descriptor, min(cut, chunk.length - 1))
    with pytest.raises(WriteFailedError):
        writer.append_chunk(chunk)
    os.close(chunk.descriptor)
    write_lines(writer, channel, 3, 1)
    writer.close()
    assert [each.log_time for each in raw_messages(path, "/one")] == [1, 3]
    assert records(path)


class FullDisk(McapBagWriter):
    """Takes no chunk for some time."""

    failures = 3

    def append_chunk(self, chunk: TopicChunk) -> None:
        self.failures -= 1
        if self.failures >= 0:
            raise WriteFailedError(self.path, OSError(errno.ENOSPC, "no space"))
        super().append_chunk(chunk)


def test_a_chunk_waits_for_room_on_the_disk(tmp_path: Path) -> None:
    recorder = Recorder(FullDisk(tmp_path / "x.mcap"))
    answered, done = threading.Event(), threading.Event()
    channels: list[int] = []

    def answer(channel: int) -> None:
        channels.append(channel)
        answered.set()

    recorder.topic_requests.open_channel("/one", LOG, "- depth: 1", answer)
    assert answered.wait(10)
    recorder.topic_requests.append_chunk(chunk_of([(channels[0], 5, b"abcd")]), done.set)
    assert done.wait(20)
    summary = recorder.close()
    assert summary.interruptions == 3
    assert summary.dropped == summary.topic_drops == 0
    assert [each.data for each in raw_messages(summary.path, "/one")] == [b"abcd"]


def test_after_the_end_everything_is_given_up(tmp_path: Path) -> None:
    recorder = Recorder(McapBagWriter(tmp_path / "x.mcap"))
    recorder.close()
    done, channels = threading.Event(), list[int]()
    requests = recorder.topic_requests
    requests.open_channel("/one", LOG, "", channels.append)
    requests.append_chunk(chunk_of([(1, 5, b"abcd")]), done.set)
    assert channels == [0]
    assert done.is_set()
    assert requests.dropped == 1
