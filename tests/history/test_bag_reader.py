"""Whatever became of a recording, what can be read of it is read."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from play_launch.history.bag_reader import BagReader, Message, NotARecordingError

if TYPE_CHECKING:
    from collections.abc import Container

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


def test_only_wanted_messages_are_given_and_all_are_counted() -> None:
    reader, messages = read(recording(), {"/odd"})
    assert numbers(messages) == list(range(1, COUNT, 2))
    assert list(reader.counts.values()) == [COUNT // 2, COUNT // 2]


@given(st.integers(8, len(recording()) - 1))
def test_a_cut_file_gives_what_comes_before_the_cut(length: int) -> None:
    reader, messages = read(recording()[:length])
    assert numbers(messages) == list(range(len(messages)))
    assert not reader.is_complete
    # A cut between two records is no damage.
    assert all(damage.offset <= length for damage in reader.damages)


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


def test_a_broken_chunk_costs_itself_only_and_is_named() -> None:
    whole = recording()
    _, before = read(whole)
    offsets = sorted({message.offset for message in before})
    second = offsets[1]
    data = bytearray(whole)
    data[second + 60] ^= 0xFF
    reader, messages = read(bytes(data))
    lost = [message for message in before if message.offset == second]
    assert lost
    assert numbers(messages) == numbers([m for m in before if m.offset != second])
    ((offset, reason, _),) = reader.damages
    assert offset == second
    assert "chunk" in reason
    assert str(reader.damages[0]).startswith(f"byte {second}: ")


@pytest.mark.parametrize("data", [b"", b"\x89MCAP0\r", b"version: 1\n" * 10])
def test_something_else_is_refused(data: bytes) -> None:
    with pytest.raises(NotARecordingError, match="not an MCAP file"):
        read(data)


def test_what_cannot_be_opened_is_named(tmp_path: Path) -> None:
    for path, reason in ((tmp_path / "no", "No such file"), (tmp_path, "no session.mcap is in")):
        with pytest.raises(NotARecordingError, match=reason):
            list(BagReader(path).messages())
