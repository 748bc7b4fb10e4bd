"""The socket to a running `topic_recorder`: from the loop, and from the recorder's thread."""

from __future__ import annotations

import array
import asyncio
import os
import socket
import threading
from collections import deque
from typing import TYPE_CHECKING, Final

from play_launch.recording.topic_recorder import packets

if TYPE_CHECKING:
    from collections.abc import Callable

_AT_ONCE: Final = 16
"""Packets that are read before the loop goes on with others."""


class RecorderLink:
    """Reads packets on the loop; sends from any thread, and never waits for either."""

    def __init__(self, ours: socket.socket, on_packet: Callable[[packets.Packet], None]) -> None:
        """Own the socket; ``on_packet`` is called on the loop."""
        ours.setblocking(False)
        self._socket = ours
        self._on_packet = on_packet
        self._buffer = bytearray(packets.LARGEST_PACKET)
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
            try:
                size, ancillary, _, _ = self._socket.recvmsg_into(
                    [self._buffer], socket.CMSG_SPACE(array.array("i").itemsize)
                )
            except BlockingIOError:
                return
            except OSError:
                size, ancillary = 0, []
            if size == 0:
                self.close()
                return
            descriptor = _descriptor(ancillary)
            try:
                packet = packets.decode(memoryview(self._buffer)[:size], descriptor)
            except packets.PacketError:
                if descriptor >= 0:
                    os.close(descriptor)
                self.close()
                raise
            self._on_packet(packet)


def _descriptor(ancillary: list[tuple[int, int, bytes]]) -> int:
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == socket.SCM_RIGHTS:
            numbers = array.array("i")
            numbers.frombytes(data)
            return numbers[0]
    return -1
