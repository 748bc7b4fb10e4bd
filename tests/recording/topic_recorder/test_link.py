"""Packets: what was sent is what is read, and nonsense is refused."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.recording.chunk import ChannelPart, TopicChunk
from play_launch.recording.topic_recorder import link

numbers = st.integers(0, 2**32 - 1)
longs = st.integers(0, 2**64 - 1)


def text(value: str) -> bytes:
    data = value.encode()
    return struct.pack("<I", len(data)) + data


@given(numbers, st.text(), st.text(), st.text())
def test_channel(request: int, topic: str, type_name: str, qos: str) -> None:
    data = struct.pack("<II", 1, request) + text(topic) + text(type_name) + text(qos)
    assert link.decode(data) == link.ChannelWanted(request, topic, type_name, qos)


@given(
    numbers,
    st.lists(longs, min_size=5, max_size=5),
    st.lists(st.tuples(st.integers(0, 65535), numbers, longs), max_size=10),
)
def test_chunk(slot: int, sizes: list[int], parts: list[tuple[int, int, int]]) -> None:
    data = struct.pack("<II5QI", 2, slot, *sizes, len(parts))
    data += b"".join(struct.pack("<HIQ", *part) for part in parts)
    length, chunk_length, records, begin, end = sizes
    made = link.decode(data, 7)
    assert made == link.ChunkMade(
        slot,
        TopicChunk(
            descriptor=7,
            length=length,
            chunk_length=chunk_length,
            records_length=records,
            begin=begin,
            end=end,
            parts=tuple(ChannelPart(*part) for part in parts),
        ),
    )
    assert made.chunk.messages == sum(count for _, count, _ in parts)


@given(st.text(), longs, longs)
def test_drops(topic: str, over_budget: int, without_room: int) -> None:
    data = struct.pack("<I", 3) + text(topic) + struct.pack("<QQ", over_budget, without_room)
    assert link.decode(data) == link.TopicDrops(topic, over_budget, without_room)


@given(st.binary(max_size=100))
def test_nonsense_is_refused(data: bytes) -> None:
    try:
        link.decode(data)
    except link.PacketError:
        return
    assert struct.unpack_from("<I", data)[0] in {1, 2, 3, 4, 5}


def test_what_goes_the_other_way_is_refused() -> None:
    for packet in (link.answer(1, 2), link.done(1), link.take(1), link.stop()):
        with pytest.raises(link.PacketError):
            link.decode(packet)
