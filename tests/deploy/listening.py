"""The service manager's end of sd_notify(3): a datagram socket, and what came through it."""

from __future__ import annotations

import os
import select
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

LIMIT = 60.0


class Listening:
    """Hears a service; `said` is all that it said, line by line."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.said: list[str] = []
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(f"\0{address[1:]}" if address.startswith("@") else address)

    @classmethod
    def in_folder(cls, folder: Path) -> Self:
        return cls(str(folder / "notify"))

    @classmethod
    def abstract(cls) -> Self:
        return cls(f"@play-launch-test-{os.getpid()}-{time.monotonic_ns()}")

    def hear(self, limit: float = 0.0) -> list[str]:
        """The lines of the next message; none when nothing comes in so many seconds."""
        ready, _, _ = select.select([self.socket], [], [], limit)
        lines = self.socket.recv(65536).decode().split("\n") if ready else []
        self.said += lines
        return lines

    def hear_all(self) -> list[str]:
        """What has come until now."""
        found: list[str] = []
        while lines := self.hear():
            found += lines
        return found

    def until(self, beginning: str) -> str:
        """Wait for a line that begins like this."""
        deadline = time.monotonic() + LIMIT
        while (left := deadline - time.monotonic()) > 0:
            for line in self.hear(left):
                if line.startswith(beginning):
                    return line
        raise AssertionError(f"no {beginning} in {LIMIT} s, but {self.said[-5:]}")

    def close(self) -> None:
        self.socket.close()


@contextmanager
def closing(listening: Listening) -> Iterator[Listening]:
    try:
        yield listening
    finally:
        listening.close()
