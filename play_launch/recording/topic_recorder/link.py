"""The socket to a running `topic_recorder`, and its packets.

``container_native/src/topic_recorder/supervisor_link.hpp`` is the other end, and describes them.
"""

from __future__ import annotations

import asyncio
import os
import socket
import struct
import threading
from collections import deque
from enum import IntEnum
from typing import TYPE_CHECKING, Final, TypeAlias

from msgspec import Struct

from play_launch.recording.chunk import ChannelPart, TopicChunk
from play_launch.supervisor.expectations import Measured

if TYPE_CHECKING:
    from collections.abc import Callable

_AT_ONCE: Final = 16
"""Packets that are read before the loop goes on with others."""
LARGEST_PACKET: Final = 1 << 18
"""Bytes; a socket's buffer takes no larger one."""

_KIND: Final = struct.Struct("<I")
_LENGTH: Final = struct.Struct("<I")
_CHUNK: Final = struct.Struct("<IQQQQQI")
_PART: Final = struct.Struct("<HIQ")
_DROPS: Final = struct.Struct("<QQ")
_SNAPSHOT: Final = struct.Struct("<IQQQ")
_MEASURED: Final = struct.Struct("<IIIQQQ")


class Kind(IntEnum):
    """The first number of a packet."""

    CHANNEL = 1
    CHUNK = 2
    DROPS = 3
    WARNING = 4
    SNAPSHOT = 5
    MEASURED = 6
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


class TopicDrops(Struct, frozen=True):
    """Messages of a topic that are not recorded, since the packet before."""

    topic: str
    over_budget: int
    without_room: int
    """As earlier ones were not written yet."""


class Warned(Struct, frozen=True):
    """Something that the user should know."""

    text: str


class SnapshotSent(Struct, frozen=True):
    """What was held was passed on, in chunks before or after this packet."""

    number: int
    messages: int
    bytes: int
    span_ns: int


Packet: TypeAlias = ChannelWanted | ChunkMade | TopicDrops | Warned | SnapshotSent | Measured


class PacketError(ValueError):
    """An unknown packet: the program is of another version."""


def decode(data: bytes, descriptor: int = -1) -> Packet:
    """Read a packet; ``descriptor`` is of the file that came with it. Raises PacketError."""
    try:
        return _decode(memoryview(data), descriptor)
    except (struct.error, ValueError) as error:
        raise PacketError(f"unknown packet of the topic recorder: {error}") from error


def answer(request: int, channel: int) -> bytes:
    """Give a topic its channel, or 0 for none."""
    return struct.pack("<IIH", Kind.ANSWER, request, channel)


def packet(kind: Kind, *numbers: int) -> bytes:
    """Return DONE with the slot of a chunk, TAKE with a number of ours, or STOP."""
    return struct.pack(f"<I{len(numbers)}I", kind, *numbers)


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
            return TopicDrops(topic, *_DROPS.unpack(rest[len(rest) - _DROPS.size :]))
        case Kind.WARNING:
            return Warned(*_texts(rest, 1))
        case Kind.SNAPSHOT:
            return SnapshotSent(*_SNAPSHOT.unpack(rest))
        case Kind.MEASURED:
            numbers = _MEASURED.unpack(rest[len(rest) - _MEASURED.size :])
            topic, types = _texts(rest, 2)
            return Measured(topic, types, *numbers)
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


class RecorderLink:
    """Reads packets on the loop; sends from any thread, and never waits for either."""

    def __init__(self, ours: socket.socket, on_packet: Callable[[Packet], None]) -> None:
        """Own the socket; ``on_packet`` is called on the loop."""
        ours.setblocking(False)
        self._socket = ours
        self._on_packet = on_packet
        self._lock = threading.Lock()
        self._unsent: deque[bytes] = deque()
        self._is_open = True
        self._ended = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(ours, self._read)

    async def ended(self) -> None:
        """Wait until the program has closed its end, and all of it was read."""
        await self._ended.wait()

    def send(self, packet: bytes) -> None:
        """Send a packet; in any thread. Nothing happens when the program is gone."""
        with self._lock:
            self._unsent.append(packet)
            self._send()

    def close(self) -> None:
        """Close the socket; on the loop. Further calls do nothing."""
        with self._lock:
            was_open, self._is_open = self._is_open, False
        if was_open:
            self._loop.remove_reader(self._socket)
            self._socket.close()
        self._ended.set()

    def _send(self) -> None:
        while self._unsent and self._is_open:
            try:
                self._socket.send(self._unsent[0])
            except BlockingIOError:
                return  # tried again with the next one, or when the program has sent something
            except OSError:
                self._unsent.clear()
                return
            self._unsent.popleft()

    def _read(self) -> None:
        with self._lock:
            self._send()
        for _ in range(_AT_ONCE):
            descriptors: list[int] = []
            try:
                data, descriptors, _, _ = socket.recv_fds(self._socket, LARGEST_PACKET, 1)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self.close()
                return
            try:
                received = decode(data, *descriptors)
            except PacketError:
                for descriptor in descriptors:
                    os.close(descriptor)
                self.close()
                raise
            self._on_packet(received)
