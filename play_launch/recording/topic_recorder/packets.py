"""Packets of the socket to `topic_recorder`; pure.

``container_native/src/topic_recorder/packet.hpp`` is the other end, and describes them.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Final, TypeAlias

from msgspec import Struct

from play_launch.recording.chunk import ChannelPart, TopicChunk

LARGEST_PACKET: Final = 1 << 18
"""Bytes; a socket's buffer takes no larger one."""

_KIND: Final = struct.Struct("<I")
_LENGTH: Final = struct.Struct("<I")
_CHUNK: Final = struct.Struct("<IQQQQQI")
_PART: Final = struct.Struct("<HIQ")
_DROPS: Final = struct.Struct("<QQ")
_SNAPSHOT: Final = struct.Struct("<IQQQ")


class Kind(IntEnum):
    """The first number of a packet."""

    CHANNEL = 1
    CHUNK = 2
    DROPS = 3
    WARNING = 4
    SNAPSHOT = 5
    ANSWER = 17
    DONE = 18
    TAKE = 19
    STOP = 20


class ChannelWanted(Struct, frozen=True):
    """A topic is about to be recorded."""

    request: int
    topic: str
    type_name: str
    offered_qos_profiles: str


class ChunkMade(Struct, frozen=True):
    """A chunk is complete; it is in the file that came with the packet."""

    slot: int
    chunk: TopicChunk


class Drops(Struct, frozen=True):
    """Messages of a topic that are not recorded, since the packet before."""

    topic: str
    over_budget: int
    without_room: int
    """As earlier ones were not written yet."""


class Warned(Struct, frozen=True):
    """Something that the user should know."""

    text: str


class HandedOver(Struct, frozen=True):
    """What was held was passed on, in chunks before or after this packet."""

    number: int
    messages: int
    bytes: int
    span_ns: int


Packet: TypeAlias = ChannelWanted | ChunkMade | Drops | Warned | HandedOver


class PacketError(ValueError):
    """An unknown packet: the program is of another version."""


def decode(data: bytes | memoryview, descriptor: int = -1) -> Packet:
    """Read a packet; ``descriptor`` is of the file that came with it. Raises PacketError."""
    try:
        return _decode(memoryview(data), descriptor)
    except (struct.error, ValueError) as error:
        raise PacketError(f"unknown packet of the topic recorder: {error}") from error


def answer(request: int, channel: int) -> bytes:
    """Give a topic its channel, or 0 for none."""
    return struct.pack("<IIH", Kind.ANSWER, request, channel)


def done(slot: int) -> bytes:
    """Give the file of a chunk back."""
    return struct.pack("<II", Kind.DONE, slot)


def take(number: int) -> bytes:
    """Ask for what is held."""
    return struct.pack("<II", Kind.TAKE, number)


def stop() -> bytes:
    """Ask for the end."""
    return struct.pack("<I", Kind.STOP)


def _decode(data: memoryview, descriptor: int) -> Packet:
    kind, rest = Kind(*_KIND.unpack_from(data)), data[_KIND.size :]
    match kind:
        case Kind.CHANNEL:
            (request,) = _LENGTH.unpack_from(rest)
            topic, type_name, qos = _texts(rest[_LENGTH.size :], 3)
            return ChannelWanted(request, topic, type_name, qos)
        case Kind.CHUNK:
            return _chunk(rest, descriptor)
        case Kind.DROPS:
            (topic,) = _texts(rest, 1)
            return Drops(topic, *_DROPS.unpack(rest[len(rest) - _DROPS.size :]))
        case Kind.WARNING:
            return Warned(*_texts(rest, 1))
        case Kind.SNAPSHOT:
            return HandedOver(*_SNAPSHOT.unpack(rest))
        case _:
            raise ValueError(f"{kind.name} goes the other way")


def _chunk(data: memoryview, descriptor: int) -> ChunkMade:
    slot, length, chunk_length, records, begin, end, count = _CHUNK.unpack_from(data)
    parts = data[_CHUNK.size :]
    if len(parts) != count * _PART.size:
        raise ValueError("a chunk with an incomplete list")
    return ChunkMade(
        slot,
        TopicChunk(
            descriptor=descriptor,
            length=length,
            chunk_length=chunk_length,
            records_length=records,
            begin=begin,
            end=end,
            parts=tuple(ChannelPart(*part) for part in _PART.iter_unpack(parts)),
        ),
    )


def _texts(data: memoryview, count: int) -> list[str]:
    texts: list[str] = []
    for _ in range(count):
        (length,) = _LENGTH.unpack_from(data)
        text = data[_LENGTH.size : _LENGTH.size + length]
        if len(text) != length:
            raise ValueError("a text that is cut")
        texts.append(str(text, "utf-8", "replace"))
        data = data[_LENGTH.size + length :]
    return texts
