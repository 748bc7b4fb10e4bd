"""What is special about writing to terminals and pipes."""

from __future__ import annotations

import contextlib
import os
import re
import sys
from typing import IO, TYPE_CHECKING, Final

import typer

if TYPE_CHECKING:
    from collections.abc import Iterator

RESET: Final = "\x1b[0m"
_COLOUR: Final = re.compile(r"\x1b\[[0-9;]*m")
_CONTROL: Final = re.compile(
    r"\x1b\[[0-?]*[ -/]*[@-~]"  # CSI: moves the cursor, erases, sets modes
    r"|\x1b\][^\x07\x1b]*(?:\x07|\x1b\\)?"  # OSC: sets titles, writes clipboards
    r"|\x1b[PX^_][^\x1b]*(?:\x1b\\)?"  # DCS and its like
    r"|\x1b."
    r"|[\x00-\x08\x0b-\x1f\x7f\x80-\x9f]"
)


def printable(text: str, *, colour: bool) -> str:
    """Take out of foreign text what would disturb a terminal.

    Tabs stay, and colours where ``colour`` is set; a text that kept colours ends without any.
    """
    if text.isprintable():
        return text
    if not colour:
        return _CONTROL.sub("", text)
    kept = _CONTROL.sub(lambda match: match[0] if _COLOUR.fullmatch(match[0]) else "", text)
    return kept + RESET if "\x1b" in kept else kept


def wants_colour(stream: IO[str]) -> bool:
    """Whether to colour what goes to ``stream``: a terminal that can, and nobody objects.

    ``NO_COLOR`` (see https://no-color.org) and ``TERM=dumb`` object; ``FORCE_COLOR`` insists.
    """
    if os.environ.get("NO_COLOR"):
        return False
    if os.environ.get("FORCE_COLOR"):
        return True
    return is_terminal(stream) and os.environ.get("TERM") != "dumb"


def is_terminal(stream: IO[str]) -> bool:
    """Whether a person looks at ``stream``; a closed one is none."""
    try:
        return stream.isatty()
    except ValueError:
        return False


def say(text: str) -> None:
    """Write ``text`` and a line end to stdout; a reader that has gone is no error."""
    with surviving_the_reader():
        typer.echo(text)


@contextlib.contextmanager
def surviving_the_reader() -> Iterator[None]:
    """Give up writing to stdout when its reader has closed it, and go on."""
    try:
        yield
    except BrokenPipeError:
        let_go_of_stdout()


def let_go_of_stdout() -> None:
    """Point stdout to nowhere, after its reader has gone.

    Otherwise Python would fail once more while it flushes at exit, and complain on stderr.
    """
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
