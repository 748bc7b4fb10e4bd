"""The terminal that the screen is on: whether it can show one, and what happens when it goes."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import termios
from typing import IO, TYPE_CHECKING, Final, cast

from textual.drivers.linux_driver import LinuxDriver

from play_launch.cli.show.terminal import is_terminal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from io import TextIOWrapper
    from types import FrameType

_USUAL_SIZE: Final = (80, 24)
_CANNOT_MOVE: Final = frozenset({"", "dumb", "unknown"})
_MOST_WAITING: Final = 10
"""Pieces of output, of the 30 that Textual's queue holds: leaving the screen writes some, too."""
_PATIENCE: Final = 3.0
"""Seconds for leaving the screen in order."""
_SIGNALS: Final = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)


def objection(stdin: IO[str], stdout: IO[str], environment: Mapping[str, str]) -> str:
    """Say why no screen can be shown, with the fix; empty: it can."""
    for stream, name in ((stdout, "standard output"), (stdin, "standard input")):
        if not is_terminal(stream):
            return (
                f"top needs a terminal, and {name} is none; play-launch ps lists what runs, and "
                "play-launch logs -f follows what nodes print"
            )
    term = environment.get("TERM", "")
    if term in _CANNOT_MOVE:
        return (
            f"top moves the cursor, and a terminal with TERM={term or '(not set)'} cannot; set "
            "TERM to what it is (xterm-256color, say), or use play-launch ps"
        )
    return ""


class Screen(LinuxDriver):
    """Textual's driver, on standard output; it survives the loss of its terminal."""

    def __init__(self, *arguments: object, **named: object) -> None:
        """Take what Textual's takes."""
        super().__init__(*arguments, **named)  # type: ignore[arg-type]
        self._handed = 0
        """Pieces that were written, by whoever writes."""
        self._output = _Output(sys.stdout.fileno())
        self._file = cast("TextIOWrapper", self._output)

    def _get_terminal_size(self) -> tuple[int, int]:
        # Textual's asks COLUMNS and LINES first, which do not change with the terminal.
        with contextlib.suppress(OSError):
            size = os.get_terminal_size(self._output.fileno())
            if size.columns and size.lines:
                return size.columns, size.lines
        return _USUAL_SIZE

    def write(self, data: str) -> None:
        """Hand a piece to the thread that writes."""
        self._handed += 1
        super().write(data)

    @property
    def is_behind(self) -> bool:
        """Whether the terminal takes less than it is given; its queue must never be full."""
        return self._handed - self._output.taken > _MOST_WAITING

    def give_back(self) -> None:
        """Restore the settings of the terminal, and nothing that it would have to be written to."""
        if self.attrs_before is not None:
            with contextlib.suppress(termios.error):
                termios.tcsetattr(self.fileno, termios.TCSANOW, self.attrs_before)

    def has_gone(self) -> bool:
        """Whether nobody can see or press anything any more, with or without a SIGHUP."""
        poll = select.poll()
        poll.register(self.fileno, 0)
        return bool(poll.poll(0)) or self._output.is_lost


class _Output:
    """Writes to a terminal in Textual's own thread, until it takes no more."""

    def __init__(self, number: int) -> None:
        self._number = number
        self.is_lost = False
        self.taken = 0
        """Pieces of which nothing is left to be written."""

    def write(self, text: str) -> int:
        """Write it all, or nothing from the first failure on: nobody would empty the queue."""
        data = memoryview(text.encode("utf-8", "replace"))
        while data and not self.is_lost:
            try:
                data = data[os.write(self._number, data) :]
            except BlockingIOError:
                # Another program has made the terminal of both of us non-blocking.
                select.select([], [self._number], [])
            except OSError:
                self.is_lost = True
        self.taken += 1
        return len(text)

    def flush(self) -> None:
        """Everything is written already."""

    def isatty(self) -> bool:
        """It is one, or was."""
        return True

    def fileno(self) -> int:
        """The descriptor."""
        return self._number


@contextlib.contextmanager
def signals_to(end: Callable[[int], None], give_back: Callable[[], None]) -> Iterator[None]:
    """Call ``end(number)`` for the first signal that is to end this process, between two lines.

    Leaving in order writes to the terminal. One that takes nothing would hold that up for ever, so
    after a while, or at once by a second signal, the process is ended by the signal itself.

    Args:
        end: Begins to leave in order.
        give_back: Restores what can be restored without writing.
    """
    before: dict[signal.Signals, object] = {}

    def on_signal(number: int, _frame: FrameType | None) -> None:
        def force(*_: object) -> None:
            give_back()
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)

        for each in before:
            signal.signal(each, force)
        signal.signal(signal.SIGALRM, force)
        signal.setitimer(signal.ITIMER_REAL, _PATIENCE)
        end(number)

    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN or number is signal.SIGINT:
            before[number] = signal.signal(number, on_signal)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]
