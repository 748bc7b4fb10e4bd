"""Chunks that another process has made: where they come to stand, and how failures end."""

from __future__ import annotations

import errno
import os
import queue
import struct
import threading
import zlib
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Metadata
from msgspec.structs import replace

from play_launch.recording.bag import BagWriter
from play_launch.recording.chunk import ChannelPart, TopicChunk
from play_launch.recording.errors import WriteFailedError
from play_launch.recording.recorder import Recorder
from play_launch.recording.resolved_form import in_messages
from play_launch.recording.topics import LOG_ALL, PARAMETER_EVENTS, PARAMETERS, Topic
from play_launch.supervisor.events import LogRecord
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


def append(writer: BagWriter, messages: list[tuple[int, int, bytes]]) -> None:
    chunk = chunk_of(messages)
    writer.append_chunk(chunk)
    os.close(chunk.descriptor)


def test_a_chunk_comes_after_what_was_written_before(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "x.mcap")
    one, two = writer.register(Topic("/one", LOG)), writer.register(Topic("/two", LOG))
    write_lines(writer, one, 100, 3)
    append(writer, [(two, 90, b"abcd"), (one, 110, b"efgh"), (two, 95, b"")])
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


@given(st.integers(0, 200))
def test_a_chunk_that_is_cut_leaves_nothing(
    tmp_path_factory: pytest.TempPathFactory, cut: int
) -> None:
    path = tmp_path_factory.mktemp("bag") / "x.mcap"
    writer = BagWriter(path)
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


class FullDisk(BagWriter):
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

    recorder.open_channel("/one", LOG, "- depth: 1", answer)
    assert answered.wait(10)
    recorder.append_chunk(chunk_of([(channels[0], 5, b"abcd")]), done.set)
    assert done.wait(20)
    summary = recorder.close()
    assert summary.interruptions == 3
    assert summary.dropped == summary.topic_drops == 0
    assert [each.data for each in raw_messages(summary.path, "/one")] == [b"abcd"]


def test_a_chunk_for_which_there_is_no_room_at_the_end_is_left_out(tmp_path: Path) -> None:
    bag = FullDisk(tmp_path / "x.mcap")
    bag.failures = 200
    recorder = Recorder(bag)
    answered = queue.SimpleQueue[int]()
    recorder.open_channel("/one", LOG, "- depth: 1", answered.put)
    channel = answered.get(timeout=10)
    done = queue.SimpleQueue[None]()
    for _ in range(20):
        chunk = chunk_of([(channel, 5, b"abcd")])
        recorder.append_chunk(chunk, lambda: done.put(None))
    recorder.publish(LogRecord(stamp_ns=1, level=40, name="n", message="a crash"))
    summary = recorder.close()
    assert done.qsize() == 20
    assert summary.interruptions <= 3, "it is tried once more"
    assert (summary.topic_drops, summary.dropped, summary.error) == (20, 0, "")
    (log,) = raw_messages(summary.path, LOG_ALL.name)
    assert b"a crash" in log.data


@pytest.mark.parametrize("descriptor", [-1, None])
def test_a_chunk_that_cannot_be_read_holds_nothing_up(
    tmp_path: Path, descriptor: int | None, caplog: pytest.LogCaptureFixture
) -> None:
    recorder = Recorder(BagWriter(tmp_path / "x.mcap"))
    topics = recorder
    channels, all_written = list[int](), threading.Event()
    topics.open_channel("/one", LOG, "", channels.append)
    written = threading.Event()
    topics.after_these(written.set)
    assert written.wait(10)
    cut, whole = (chunk_of([(channels[0], time, b"abcd")]) for time in (5, 6))
    os.ftruncate(cut.descriptor, 10)
    if descriptor is not None:  # the kernel passes none on when there are too many
        os.close(cut.descriptor)
        cut = replace(cut, descriptor=descriptor)
    given_back: list[int] = []
    topics.append_chunk(cut, lambda: given_back.append(1))
    topics.append_chunk(whole, lambda: given_back.append(2))
    topics.after_these(all_written.set)
    assert all_written.wait(10)
    summary = recorder.close()
    assert given_back == [1, 2]
    assert (summary.error, summary.interruptions, summary.topic_drops) == ("", 0, 1)
    assert [each.log_time for each in raw_messages(summary.path, "/one")] == [6]
    (drops,) = [each for each in records(summary.path) if isinstance(each, Metadata)]
    assert drops.metadata == {"/one": "1"}
    (error,) = caplog.records
    assert "its memory" in error.getMessage()


def test_secrets_are_masked_in_what_is_about_parameters(tmp_path: Path) -> None:
    recorder = Recorder(BagWriter(tmp_path / "x.mcap"))
    requests = recorder
    secrets = {"token", "token-and-more", "4711", "1234.5", "abc", "****"}
    # These are everywhere, in lengths as well.
    requests.secrets = in_messages({*secrets, "0000", "0.00", "0x01"})
    channels, answered = list[int](), threading.Event()
    for topic in (PARAMETERS, Topic("/one", LOG), PARAMETER_EVENTS):
        requests.open_channel(topic.name, topic.type_name, "", channels.append)
    requests.after_these(answered.set)
    assert answered.wait(10)
    text = b"a token-and-more, token; abcd"
    zeros = struct.pack("<qqd", 0, 1, 0.0)
    number = zeros + struct.pack("<qdI", 4711, 1234.5, 4) + b"abc\0"
    messages = [(channel, 1 + at, text + number) for at, channel in enumerate(channels)]
    requests.append_chunk(chunk_of([*messages, (channels[0], 9, b"****")]), lambda: None)
    path = recorder.close().path
    masked = b"a **************, *****; abcd" + zeros + b"*" * 16 + struct.pack("<I", 4) + b"***\0"
    assert [each.data for each in raw_messages(path, PARAMETERS.name)] == [masked, b"****"]
    assert [each.data for each in raw_messages(path, PARAMETER_EVENTS.name)] == [masked]
    assert [each.data for each in raw_messages(path, "/one")] == [text + number]
    with path.open("rb") as file:
        assert len(list(make_reader(file, validate_crcs=True).iter_messages())) == 4
