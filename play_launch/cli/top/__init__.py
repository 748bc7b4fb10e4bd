"""``play-launch top``: a screen of a running session, on Textual."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import termios
from typing import TYPE_CHECKING, Final

from play_launch.cli import options
from play_launch.cli.connection import connected, report_end
from play_launch.cli.output import is_terminal, redirect_to_devnull, wants_colour
from play_launch.control.protocol import Code, OperationError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

    from play_launch.cli.top.app import ScreenEnd
    from play_launch.control.client import ControlClient

_LEAVE_TIMEOUT: Final = 3.0
"""Seconds after a signal for restoring the screen, which a blocked terminal would delay forever."""
_SIGNALS: Final = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)


def top(session: options.Session = None) -> int:
    """Watch and operate a session on a screen; ? lists the keys.

    Leaving it changes nothing in the session. For programs: ps --json, events -f --json.
    """
    with connected(session) as client:
        _require_terminal()
        try:
            import textual  # noqa: F401, PLC0415 - an extra
        except ModuleNotFoundError:
            raise OperationError(
                Code.BAD_ARGUMENTS,
                "top needs Textual, which is not installed; pip install 'play-launch-py[top]'",
            ) from None
        end = asyncio.run(_show(client))
    if end.signal == signal.SIGHUP:  # the terminal is gone
        redirect_to_devnull(sys.stdout)
        redirect_to_devnull(sys.stderr)
    if end.signal:
        return 128 + end.signal
    return report_end(client.hello, end.reason) if end.is_lost else 0


def _require_terminal() -> None:
    streams = {"output": sys.stdout, "input": sys.stdin, "error": sys.stderr}
    for name, stream in streams.items():
        if not is_terminal(stream):
            raise OperationError(
                Code.BAD_ARGUMENTS,
                f"top needs a terminal, and standard {name} is not one; play-launch ps lists what "
                "runs, and play-launch logs -f follows the output",
            )
    term = os.environ.get("TERM", "")
    if term in {"", "dumb", "unknown"}:
        raise OperationError(
            Code.BAD_ARGUMENTS,
            f"top moves the cursor, and a terminal with TERM={term or '(not set)'} cannot; set "
            "TERM to the type of the terminal (xterm-256color, for example), or use play-launch ps",
        )


async def _show(client: ControlClient) -> ScreenEnd:
    from play_launch.cli.top.app import TopApp  # noqa: PLC0415 - slow

    has_colours = wants_colour(sys.stdout)
    for name in ("NO_COLOR", "COLUMNS", "LINES"):  # the size would not change with the terminal
        os.environ.pop(name, None)
    if not has_colours:
        os.environ["NO_COLOR"] = "1"
    app = TopApp(client)
    with _signals_to(app.end_by):
        # Without the mouse, text can still be selected in the terminal's own way.
        end = await app.run_async(mouse=False)
    if end is None:
        # Textual has written the traceback.
        raise OperationError(Code.INTERNAL, "the screen failed; this is a bug of play-launch")
    return end


@contextlib.contextmanager
def _signals_to(end: Callable[[int], None]) -> Iterator[None]:
    """Call ``end(number)`` for the first signal; a second one or a timeout ends the process."""
    attributes = termios.tcgetattr(sys.stdin)

    def force(number: int, _frame: FrameType | None) -> None:
        with contextlib.suppress(termios.error):
            termios.tcsetattr(sys.stdin, termios.TCSANOW, attributes)
        number = signal.SIGTERM if number == signal.SIGALRM else number
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)

    def on_signal(number: int, _frame: FrameType | None) -> None:
        for each in before:
            signal.signal(each, force)
        signal.signal(signal.SIGALRM, force)
        signal.setitimer(signal.ITIMER_REAL, _LEAVE_TIMEOUT)
        end(number)

    before = {
        number: signal.signal(number, on_signal)
        for number in _SIGNALS
        if signal.getsignal(number) is not signal.SIG_IGN or number is signal.SIGINT
    }
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)
