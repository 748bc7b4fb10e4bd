"""What a process writes, as whole lines.

`LineSplitter` is pure. `LineReader` feeds one from a pipe on the event loop.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias
from weakref import WeakKeyDictionary

from play_launch.supervisor.events import Stream

MAX_LINE_BYTES = 16 * 1024
"""Longer lines are cut here and marked as truncated."""
_READ_BYTES = 64 * 1024
_LEAST_BYTES = 4 * 1024
_LINES = 1000
"""Lines that are read at once, roughly: their sinks take some 10 µs for each."""
_SHORT, _LONGEST = 0.002, 0.1
"""Seconds: a batch that takes less holds up nothing; longer ones were held up themselves."""


class Line(NamedTuple):
    """One line without its line end; of a truncated one the rest is dropped."""

    text: str
    truncated: bool = False


LinesCallback: TypeAlias = Callable[[Sequence[Line]], None]
OutputCallback: TypeAlias = Callable[[Stream, Sequence[Line]], None]
"""Gets each batch of lines; it is called on the loop's thread and must not block."""


class LineSplitter:
    r"""Cuts bytes that arrive in pieces of any size into lines.

    A line ends with `\n`, `\r\n` or `\r` (progress bars), as terminals show it, wherever the
    pieces are cut. Bytes that are not UTF-8 become U+FFFD. At most `max_bytes` of a line are
    kept: the first ones, cut before an incomplete character; memory is bounded by that.
    """

    def __init__(self, max_bytes: int = MAX_LINE_BYTES) -> None:
        self._max_bytes = max_bytes
        self._partial = b""
        self._skipping = False  # the rest of a truncated line
        self._after_return = False  # a \n now belongs to the \r before

    def feed(self, data: bytes) -> list[Line]:
        """Take the next piece and give the lines that it ends, or that grew too long."""
        if not data:
            return []
        if self._after_return and data.startswith(b"\n"):
            data = data[1:]
        self._after_return = data.endswith(b"\r") if data else False
        pieces = data.splitlines(keepends=True)
        lines: list[Line] = []
        for piece in pieces:
            if piece.endswith((b"\n", b"\r")):
                self._end_line(piece.rstrip(b"\r\n"), lines)
            else:
                self._extend(piece, lines)
        return lines

    def finish(self) -> list[Line]:
        """Give the line that the end of the output left without a line end, if there is one."""
        lines = [] if self._skipping or not self._partial else [_line(self._partial)]
        self._partial = b""
        self._skipping = False
        self._after_return = False
        return lines

    def _end_line(self, rest: bytes, lines: list[Line]) -> None:
        if self._skipping:
            self._skipping = False
            return
        content = self._partial + rest if self._partial else rest
        self._partial = b""
        if len(content) > self._max_bytes:
            lines.append(self._cut(content))
        else:
            lines.append(_line(content))

    def _extend(self, piece: bytes, lines: list[Line]) -> None:
        if self._skipping:
            return
        self._partial += piece
        if len(self._partial) > self._max_bytes:
            lines.append(self._cut(self._partial))
            self._partial = b""
            self._skipping = True

    def _cut(self, content: bytes) -> Line:
        end = self._max_bytes
        for start in range(end - 1, max(end - 4, -1), -1):
            byte = content[start]
            if byte < 0x80:
                break
            if byte >= 0xC0:  # the first byte of a character: keep it only when it is whole
                length = 2 if byte < 0xE0 else 3 if byte < 0xF0 else 4
                if start + length > end:
                    end = start
                break
        return Line(content[:end].decode(errors="replace"), truncated=True)


def _line(content: bytes) -> Line:
    return Line(content.decode(errors="replace"))


class _Turns:
    """Lets the readers of a loop read one after the other, for two thirds of its time together.

    After a batch that took long, nothing is read for half as long as that. Then the pipes of
    processes that write without pause are full, and they wait.
    """

    def __init__(self) -> None:
        self._free_at = 0.0
        """By `time.monotonic`."""
        self._waiting: deque[LineReader] = deque()

    def take(self, reader: LineReader) -> None:
        """Have a reader read what has come, now or in its turn."""
        if not self._waiting and time.monotonic() >= self._free_at:
            self._read(reader)
            return
        reader.pause()
        self._waiting.append(reader)
        if len(self._waiting) == 1:
            self._wait()

    def _wait(self) -> None:
        delay = max(self._free_at - time.monotonic(), 0.0)
        asyncio.get_running_loop().call_later(delay, self._next)

    def _next(self) -> None:
        reader = self._waiting.popleft()
        try:
            if reader.is_open:
                reader.resume()
                self._read(reader)
        finally:
            if self._waiting:
                self._wait()

    def _read(self, reader: LineReader) -> None:
        began = time.monotonic()
        reader.read()
        took = time.monotonic() - began
        if took > _SHORT:
            self._free_at = began + took + min(took / 2, _LONGEST)


_turns: WeakKeyDictionary[asyncio.AbstractEventLoop, _Turns] = WeakKeyDictionary()


class LineReader:
    """Reads a pipe on the event loop until its end and delivers lines in batches.

    It owns the descriptor from the start and closes it at the end of the output or on `close`.
    One batch is what one read gave.
    """

    def __init__(self, descriptor: int, on_lines: LinesCallback) -> None:
        self._descriptor = descriptor
        self._on_lines = on_lines
        self._splitter = LineSplitter()
        self._size = _READ_BYTES
        self._loop = asyncio.get_running_loop()
        self._turns = _turns.setdefault(self._loop, _Turns())
        self._ended = asyncio.Event()
        os.set_blocking(descriptor, False)
        self.resume()

    @property
    def is_open(self) -> bool:
        """Whether more output may come."""
        return self._descriptor >= 0

    async def wait_end(self) -> None:
        """Wait until the pipe is closed and everything is delivered."""
        await self._ended.wait()

    def close(self) -> None:
        """Give up reading, after handing over what the pipe holds; may be called twice.

        For a pipe that some process outside our reach keeps open after its owner died.
        """
        if self._descriptor < 0:
            return
        # As much as a pipe holds by default; an endless writer must not keep us here.
        self._size = _READ_BYTES
        if self.read():
            self._end()

    def pause(self) -> None:
        """Leave in the pipe what comes, up to `resume`."""
        self._loop.remove_reader(self._descriptor)

    def resume(self) -> None:
        self._loop.add_reader(self._descriptor, self._turns.take, self)

    def read(self) -> bool:
        """Read once, and deliver the lines; return whether more may come."""
        try:
            data = os.read(self._descriptor, self._size)
        except (BlockingIOError, InterruptedError):
            return True
        except OSError:
            data = b""
        if not data:
            self._end()
            return False
        lines = self._splitter.feed(data)
        if lines:
            size = len(data) * _LINES // len(lines)
            self._size = min(max(size, _LEAST_BYTES), _READ_BYTES)
            self._on_lines(lines)
        return True

    def _end(self) -> None:
        self._loop.remove_reader(self._descriptor)
        os.close(self._descriptor)
        self._descriptor = -1
        self._ended.set()
        lines = self._splitter.finish()
        if lines:
            self._on_lines(lines)
