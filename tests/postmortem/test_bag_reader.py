"""Whatever became of a recording, what can be read of it is read."""

from __future__ import annotations

import errno
import os
import tempfile
import tracemalloc
from functools import cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from play_launch.postmortem import bag_reader
from play_launch.postmortem.bag_reader import BagReader, Message, NotARecordingError
from play_launch.postmortem.recover import write_whole
from play_launch.recording.bag import BagWriter
from play_launch.recording.folder import MAGIC, open_bag
from play_launch.recording.topics import LOG_ALL, OUTPUT

if TYPE_CHECKING:
    from collections.abc import Container
    from typing import Self

COUNT = 40


@cache
def recording(compression: CompressionType = CompressionType.ZSTD) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.mcap"
        with path.open("wb") as file:
            writer = Writer(file, chunk_size=300, compression=compression)
            writer.start("ros2", "test")
            writer.add_attachment(1, 1, "config.yaml", "text/yaml", b"version: 1")
            writer.add_metadata("play_launch.session", {"name": "x"})
            schema = writer.register_schema("a/msg/B", "ros2msg", b"")
            channels = [
                writer.register_channel(topic, "cdr", schema) for topic in ("/even", "/odd")
            ]
            for number in range(COUNT):
                data = number.to_bytes(2, "little") * 20
                writer.add_message(channels[number % 2], 1000 + number, data, number)
            writer.finish()
        return path.read_bytes()


def read(data: bytes, wanted: Container[str] | None = None) -> tuple[BagReader, list[Message]]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.mcap"
        path.write_bytes(data)
        reader = BagReader(path)
        return reader, list(reader.messages(wanted))


def numbers(messages: list[Message]) -> list[int]:
    return [int.from_bytes(message.data[:2], "little") for message in messages]


@pytest.mark.parametrize("compression", CompressionType)
def test_a_whole_file_is_read(compression: CompressionType) -> None:
    reader, messages = read(recording(compression))
    assert numbers(messages) == list(range(COUNT))
    assert [message.topic.name for message in messages[:2]] == ["/even", "/odd"]
    assert (messages[5].log_time, messages[5].publish_time) == (1005, 5)
    assert reader.is_complete
    assert reader.damages == []
    assert (reader.begin, reader.end) == (1000, 1000 + COUNT - 1)
    assert reader.attachments["config.yaml"].data == b"version: 1"
    assert reader.metadata == {"play_launch.session": {"name": "x"}}


@pytest.mark.parametrize("messages", range(1, 36))
def test_topics_with_one_message_and_with_many_stand_in_one_chunk(
    tmp_path: Path, messages: int
) -> None:
    """The index of 17 messages begins like one of a single message."""
    writer = BagWriter(tmp_path / "session.mcap")
    once, often = writer.register(OUTPUT), writer.register(LOG_ALL)
    for chunk in range(3):
        for channel in (once, *[often] * messages):
            writer.write(channel, b"\0\1\0\0text", log_time=chunk, publish_time=chunk)
        writer.flush()
    writer.close()
    reader = BagReader(writer.path)
    assert len(list(reader.messages())) == 3 * (1 + messages)
    assert reader.is_complete


def test_only_wanted_messages_are_given_and_all_are_counted() -> None:
    reader, messages = read(recording(), {"/odd"})
    assert numbers(messages) == list(range(1, COUNT, 2))
    assert list(reader.counts.values()) == [COUNT // 2, COUNT // 2]


@given(
    st.lists(
        st.tuples(st.integers(8, len(recording()) - 1), st.integers(1, 255)),
        min_size=1,
        max_size=4,
    )
)
def test_a_damaged_file_gives_the_rest(flips: list[tuple[int, int]]) -> None:
    data = bytearray(recording())
    for at, mask in flips:
        data[at] ^= mask
    reader, messages = read(bytes(data))
    found = [message for message in messages if len(message.data) == 2 * 20]
    assert len(messages) <= COUNT
    # Chunks have checksums, so that what is in them is right or missing.
    assert set(numbers(found)) <= set(range(COUNT))
    if len(messages) < COUNT:
        assert reader.damages or not reader.is_complete


@pytest.mark.parametrize("data", [b"", b"\x89MCAP0\r", b"version: 1\n" * 10])
def test_something_else_is_refused(data: bytes) -> None:
    with pytest.raises(NotARecordingError, match="not an MCAP file"):
        read(data)


def test_what_cannot_be_opened_is_named(tmp_path: Path) -> None:
    (tmp_path / "killed.mcap.active").touch()
    for path, reason in (
        (tmp_path / "no", "No such file or directory$"),
        (tmp_path / "killed.mcap", "directory; there is killed.mcap.active, unfinished"),
        (tmp_path, "no session.mcap is in"),
    ):
        with pytest.raises(NotARecordingError, match=reason):
            list(BagReader(path).messages())


class DiskFile:
    """A file on a disk with sectors that cannot be read."""

    def __init__(self, disk: Disk, file: IO[bytes]) -> None:
        self._disk = disk
        self._file = file

    def read(self, size: int = -1) -> bytes:
        self._disk.largest = max(self._disk.largest, size)
        at = self._file.tell()
        data = self._file.read(size)
        if at <= self._disk.bad < at + len(data):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return data

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


class Disk:
    bad = -1
    """Which byte cannot be read."""
    largest = 0
    """Bytes that were asked for at once."""


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    made = Disk()
    monkeypatch.setattr(bag_reader, "open_bag", lambda path: DiskFile(made, open_bag(path)))
    return made


def test_a_sector_that_cannot_be_read_costs_what_is_in_it(disk: Disk, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(recording())
    reader = BagReader(path)
    before = [(reader.offset, message) for message in reader.messages()]
    offsets = sorted({offset for offset, _ in before})
    # Within a chunk, but for the first one, which describes channels; then within the summary.
    for lost, bad in (*((at, at + 20) for at in offsets[1:]), (-1, len(recording()) - 200)):
        disk.bad = bad
        reader = BagReader(path)
        expected = numbers([message for offset, message in before if offset != lost])
        assert numbers(list(reader.messages())) == expected
        (damage,) = reader.damages
        assert "Input/output error" in damage.reason
        assert reader.is_complete == (lost >= 0)
        recovered = write_whole(path, tmp_path / "whole.mcap")
        assert recovered.messages == len(expected)
        disk.bad = -1
        assert numbers(list(BagReader(recovered.path).messages())) == expected


@pytest.mark.parametrize(
    "kind",
    [
        *(Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK, Opcode.ATTACHMENT),
        *(Opcode.METADATA, Opcode.MESSAGE, Opcode.MESSAGE_INDEX, Opcode.DATA_END),
    ],
)
def test_a_wrong_length_takes_no_memory(disk: Disk, kind: Opcode, tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "x.mcap")
    writer.attach("config.yaml", "application/yaml", b"a: 1", time=1)
    writer.metadata("play_launch.session", {"name": "x"})
    channel = writer.register(OUTPUT)
    writer.write(channel, b"abc", log_time=1, publish_time=1)
    writer.close()
    data = bytearray(writer.path.read_bytes())
    at = len(MAGIC)
    while data[at] != (Opcode.HEADER if kind == Opcode.MESSAGE else kind):
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    data[at] = kind
    data[at + 1 : at + 9] = (300_000_000).to_bytes(8, "little")
    writer.path.write_bytes(data)
    os.truncate(writer.path, 310_000_000)
    reader = BagReader(writer.path)
    list(reader.messages())
    assert disk.largest < 20_000_000
    assert reader.damages


@pytest.mark.parametrize("name", ["lz4", "zstd"])
def test_a_chunk_takes_no_more_memory_than_it_names(tmp_path: Path, name: str) -> None:
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 30, compression=CompressionType[name.upper()])
        writer.start()
        channel = writer.register_channel("/x", "cdr", 0)
        writer.add_message(channel, 1, bytes(50_000_000), 1)
        writer.finish()
    data = path.read_bytes()
    at = data.index(name.encode()) - 16  # behind it: checksum, length of the name
    path.write_bytes(data[:at] + (100).to_bytes(8, "little") + data[at + 8 :])
    reader = BagReader(path)
    tracemalloc.start()
    try:
        assert list(reader.messages()) == []
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert reader.damages
    assert most < 20_000_000


def test_what_follows_the_end_takes_no_memory(disk: Disk, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(recording())
    os.truncate(path, 310_000_000)
    reader = BagReader(path)
    assert len(list(reader.messages())) == COUNT
    assert disk.largest < 20_000_000
    assert not reader.is_complete


def test_damages_are_listed_up_to_a_number(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    no_record = b"\x0e" + bytes(8)
    path.write_bytes(MAGIC + no_record * 5000)
    reader = BagReader(path)
    assert list(reader.messages()) == []
    assert len(reader.damages) == 101
    assert reader.damages[0].reason == "no record of kind 0x0e can stand here"
    assert str(reader.damages[-1]) == (
        f"byte {len(MAGIC) + 9 * 100}: from here on 4,900 places cannot be read"
    )


def test_a_number_in_a_name_is_no_number_of_files(tmp_path: Path) -> None:
    for name in ("session.mcap", "session_900000000.mcap"):
        (tmp_path / name).write_bytes(recording())
    reader = BagReader(tmp_path)
    assert len(list(reader.messages())) == 2 * COUNT
    assert str(reader.damages[0]) == "session_1.mcap: byte 0: the file is missing"
    assert "899,999,899 places" in reader.damages[-1].reason
