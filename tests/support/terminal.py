"""A program on a terminal of its own, and what a person sees on it."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator, Mapping
from typing import Any

import pyte

from tests.support.waiting import LIMIT, until

# The terminal becomes that of a session of its own, as for a login; the process stays the same.
_TAKE_TERMINAL = """
import fcntl, os, sys, termios
os.setsid()
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execvp(sys.argv[1], sys.argv[1:])
"""

_KEYBOARD_MODES = re.compile(rb"\x1b\[[<>=]\d*u")


class Terminal:
    """A terminal emulator with one program on it."""

    def __init__(
        self, command: list[str], columns: int, lines: int, env: Mapping[str, str]
    ) -> None:
        self._ours, self.theirs = pty.openpty()
        self._screen = pyte.Screen(columns, lines)
        self._stream = pyte.ByteStream(self._screen)
        self._lock = threading.Lock()
        self.raw = bytearray()
        self.is_reading = threading.Event()
        """Clear: whatever is written waits."""
        self.is_reading.set()
        self._is_closing = threading.Event()
        self._set_size(columns, lines)
        self.settings = termios.tcgetattr(self.theirs)
        """As they were before the program."""
        self.process = subprocess.Popen(
            [sys.executable, "-c", _TAKE_TERMINAL, *command],
            stdin=self.theirs,
            stdout=self.theirs,
            stderr=self.theirs,
            env=env,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        while not self._is_closing.is_set():
            self.is_reading.wait()
            # A descriptor that a thread reads from is not closed by closing it.
            if not select.select([self._ours], [], [], 0.05)[0]:
                continue
            try:
                data = os.read(self._ours, 65536)
            except OSError:
                return
            if not data:
                return
            with self._lock:
                self.raw += data
                # The emulator takes the end of these for a letter.
                self._stream.feed(_KEYBOARD_MODES.sub(b"", data))

    def _set_size(self, columns: int, lines: int) -> None:
        fcntl.ioctl(self._ours, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))

    def resize(self, columns: int, lines: int) -> None:
        """Make the window another size; the program gets SIGWINCH."""
        with self._lock:
            self._screen.resize(lines, columns)
        self._set_size(columns, lines)

    def press(self, keys: str) -> None:
        """Type."""
        os.write(self._ours, keys.encode())

    def lines(self) -> list[str]:
        """What is seen, from the top."""
        with self._lock:
            return [line.rstrip() for line in self._screen.display]

    def line(self, what: str) -> str:
        """The first line that has a text in it, or an empty one."""
        return next((line for line in self.lines() if what in line), "")

    def look(self, line: int, column: int) -> Any:
        """One cell: its data, fg, bg, bold, reverse."""
        with self._lock:
            return self._screen.buffer[line][column]

    def until_seen(self, what: str, limit: float = LIMIT) -> None:
        """Look until a text is on the screen."""
        try:
            until(lambda: bool(self.line(what)), f"{what!r} on the screen", limit)
        except AssertionError as error:
            seen = "\n".join(self.lines())
            raise AssertionError(f"{error}; {self.process.poll()}, there is:\n{seen}") from None

    def until_gone(self, what: str, limit: float = LIMIT) -> None:
        """Look until a text is on the screen no more."""
        until(lambda: not self.line(what), f"{what!r} to leave the screen", limit)

    def unread(self) -> int:
        """Bytes that the program has written and that are unread."""
        (count,) = struct.unpack("i", fcntl.ioctl(self._ours, termios.FIONREAD, b"\0" * 4))
        return int(count)

    def has_old_settings(self) -> bool:
        """Whether the settings are as before, whatever is on the screen."""
        return bool(termios.tcgetattr(self.theirs) == self.settings)

    def is_restored(self) -> bool:
        """Whether the settings are as before, and so is the screen itself."""
        modes = {
            b"\x1b[?1049": (b"l", b"h"),
            b"\x1b[?25": (b"h", b"l"),
            b"\x1b[?2004": (b"l", b"h"),
        }
        with self._lock:
            raw = bytes(self.raw)
        last = {
            mode: raw[raw.rfind(mode) + len(mode) : raw.rfind(mode) + len(mode) + 1]
            for mode in modes
            if mode in raw
        }
        return self.has_old_settings() and all(end == modes[mode][0] for mode, end in last.items())

    def end(self, limit: float = LIMIT) -> int:
        """Wait for the program to end, and until what it wrote is read; its return code."""
        code = self.process.wait(timeout=limit)
        # Nothing comes any more when the terminal has been quiet: its buffer is small.
        size = -1
        while size != len(self.raw):
            size = len(self.raw)
            self._reader.join(0.1)
        return code

    def hang_up(self) -> None:
        """Close the window."""
        self._is_closing.set()
        self.is_reading.set()
        self._reader.join()
        for number in (self.theirs, self._ours):
            if number >= 0:
                os.close(number)
        self.theirs = self._ours = -1

    def close(self) -> None:
        """End the program, if it runs, and close the terminal."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self.hang_up()


@contextlib.contextmanager
def on_terminal(
    *command: str, columns: int = 80, lines: int = 24, **environment: str
) -> Iterator[Terminal]:
    """Run a program on a terminal; afterwards both are gone."""
    env = {
        name: value
        for name, value in os.environ.items()
        if name not in {"NO_COLOR", "FORCE_COLOR", "COLUMNS", "LINES", "COLORTERM"}
    }
    terminal = Terminal(
        list(command), columns, lines, {**env, "TERM": "xterm-256color", **environment}
    )
    try:
        yield terminal
    finally:
        terminal.close()
