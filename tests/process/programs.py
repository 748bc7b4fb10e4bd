"""Small programs that behave in some way, and what the tests look at."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from play_launch.process.lines import Line
from play_launch.supervisor.events import Stream


def python(code: str) -> list[str]:
    """Run `code` in a Python that starts fast: no site-packages."""
    return [sys.executable, "-I", "-S", "-c", code]


def shell(script: str) -> list[str]:
    return ["/bin/sh", "-c", script]


READY_THEN_SLEEP = "print('ready', flush=True); import time; time.sleep(600)"


def deaf_to(*signals: str) -> list[str]:
    """A program that ignores these signals and prints each."""
    ignore = "".join(f"signal.signal(signal.{name}, signal.SIG_IGN);" for name in signals)
    return python(f"import signal; {ignore} {READY_THEN_SLEEP}")


def open_descriptors() -> dict[int, str]:
    """Our descriptors and what they are, without the one this very look needs."""
    found = {}
    for entry in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):
            found[int(entry.name)] = str(entry.readlink())
    return found


def environment() -> dict[str, str]:
    return {"PATH": os.defpath, "LANG": "C.UTF-8"}


class Output:
    """Collects what a child writes; an `OutputCallback`."""

    def __init__(self) -> None:
        self.lines: dict[Stream, list[Line]] = {stream: [] for stream in Stream}
        self._more = asyncio.Event()

    def __call__(self, stream: Stream, lines: Sequence[Line]) -> None:
        self.lines[stream] += lines
        self._more.set()

    def texts(self, stream: Stream = Stream.STDOUT) -> list[str]:
        return [line.text for line in self.lines[stream]]

    async def wait_line(self, start: str) -> str:
        """Wait for a line on stdout that starts so and give the rest of it."""
        async with asyncio.timeout(60):
            while True:
                for text in self.texts():
                    if text.startswith(start):
                        return text[len(start) :].strip()
                self._more.clear()
                await self._more.wait()


def exists(pid: int) -> bool:
    """Whether this pid is a process that runs or waits to be waited for."""
    return Path(f"/proc/{pid}").exists()
