from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING

import pytest
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema
from mcap.stream_reader import StreamReader

from play_launch.container.cdr.messages import log_message
from play_launch.recording.bag import BagWriter
from play_launch.recording.errors import WriteFailedError
from play_launch.recording.topics import ALL_TOPICS, OUTPUT
from tests.recording.reading import messages, raw_messages, records

if TYPE_CHECKING:
    from pathlib import Path


def write_lines(writer: BagWriter, channel: int, first: int, count: int) -> None:
    for number in range(first, first + count):
        data = log_message(number, 20, "/a", f"line {number}", file="stdout")
        writer.write(channel, data, log_time=number, publish_time=number)


def test_a_bag_follows_the_ros2_profile(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "x.mcap")
    writer.attach("config.yaml", "application/yaml", b"a: 1\n", time=5)
    writer.metadata("play_launch.session", {"id": "1"})
    channels = [writer.register(topic) for topic in ALL_TOPICS]
    write_lines(writer, channels[ALL_TOPICS.index(OUTPUT)], 1, 3)
    writer.flush()
    writer.close()

    assert writer.path == tmp_path / "x.mcap"
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.mcap"]
    assert writer.bytes_written == writer.path.stat().st_size
    found = list(records(writer.path))
    header, attachment, metadata = found[:3]
    assert isinstance(header, Header)
    assert (header.profile, header.library) == ("ros2", "play_launch")
    assert isinstance(attachment, Attachment)
    assert attachment.data == b"a: 1\n"
    assert isinstance(metadata, Metadata)
    for record in found:
        if isinstance(record, Channel):
            assert record.message_encoding == "cdr"
            assert record.metadata["offered_qos_profiles"]
        elif isinstance(record, Schema):
            assert record.encoding == "ros2msg"
    with writer.path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 3
    assert {channel.topic for channel in summary.channels.values()} == {
        topic.name for topic in ALL_TOPICS
    }


def test_chunks_are_compressed_and_at_most_one_mebibyte(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "x.mcap")
    channel = writer.register(OUTPUT)
    for number in range(200):
        data = log_message(number, 20, "/a", "x" * 16_000)
        writer.write(channel, data, log_time=number, publish_time=number)
    writer.close()
    with writer.path.open("rb") as file:
        chunks = [
            record
            for record in StreamReader(file, emit_chunks=True).records
            if isinstance(record, Chunk)
        ]
    assert len(chunks) > 2
    assert {chunk.compression for chunk in chunks} == {"zstd"}
    assert max(chunk.uncompressed_size for chunk in chunks) <= 1024 * 1024


def test_quality_of_service_is_read_by_others(tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    writer = BagWriter(tmp_path / "x.mcap")
    for topic in ALL_TOPICS:
        write_lines(writer, writer.register(topic), 1, 1)
    writer.close()
    with AnyReader([writer.path]) as reader:
        profiles = {
            connection.topic: connection.ext.offered_qos_profiles[0]  # type: ignore[union-attr]
            for connection in reader.connections
        }
    for topic in ALL_TOPICS:
        profile = profiles[topic.name]
        assert profile.history.name == "KEEP_LAST"
        assert profile.depth == topic.depth
        assert profile.reliability.name == "RELIABLE"
        assert profile.durability.name == ("TRANSIENT_LOCAL" if topic.latched else "VOLATILE")
        assert profile.liveliness.name == "AUTOMATIC"


class FullDisk:
    """Stands for ``os.pwrite`` on a file system with a given number of bytes left."""

    def __init__(self, left: int, error: int = errno.ENOSPC) -> None:
        self.left = left
        self.error = error
        self.write = os.pwrite

    def __call__(self, descriptor: int, data: memoryview, at: int) -> int:
        if self.left == 0:
            raise OSError(self.error, os.strerror(self.error))
        count = self.write(descriptor, data[: self.left], at)
        self.left -= count
        return count


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (errno.ENOSPC, r"No space left .*; free some space"),
        (errno.EFBIG, r"File too large; set record\.rotate\.size"),
    ],
)
def test_a_full_disk_keeps_every_complete_chunk(
    error: int, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = BagWriter(tmp_path / "x.mcap")
    channel = writer.register(OUTPUT)
    write_lines(writer, channel, 0, 10)
    writer.flush()
    before = writer.bytes_written
    monkeypatch.setattr(os, "pwrite", FullDisk(100, error))
    write_lines(writer, channel, 10, 10)
    with pytest.raises(WriteFailedError, match=words) as caught:
        writer.flush()
    assert str(writer.path) in str(caught.value)
    assert writer.path.stat().st_size == before
    assert len(raw_messages(writer.path, OUTPUT.name)) == 10

    monkeypatch.undo()
    writer.flush()
    write_lines(writer, channel, 20, 10)
    writer.close()
    found = raw_messages(writer.path, OUTPUT.name)
    assert [message.log_time for message in found] == [*range(30)]
    assert [message.sequence for message in found] == [*range(1, 31)]
    assert len(messages(writer.path)) == 30


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "x.mcap.active").write_bytes(b"precious")
    with pytest.raises(WriteFailedError, match="File exists"):
        BagWriter(tmp_path / "x.mcap")
    assert (tmp_path / "x.mcap.active").read_bytes() == b"precious"
