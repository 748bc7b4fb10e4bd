"""What is special about writing to terminals and pipes."""

from __future__ import annotations

import contextlib
import os
import re
import sys
from typing import IO, TYPE_CHECKING, Final

from play_launch.cli.show.streams import is_about_output, let_go_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

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

    ``NO_COLOR`` (see https://no-color.org) and a terminal of a type without colours (``TERM=dumb``,
    ``TERM=vt100``) object; ``FORCE_COLOR`` insists.
    """
    if os.environ.get("NO_COLOR"):
        return False
    if os.environ.get("FORCE_COLOR"):
        return True
    return is_terminal(stream) and has_colours(os.environ.get("TERM", ""))


def has_colours(term: str) -> bool:
    """Whether a type of terminal has colours; one that terminfo does not know has."""
    if term in {"", "dumb", "unknown"}:
        return not term
    try:
        import curses  # noqa: PLC0415 - for terminals only
    except ImportError:  # Python can be built without
        return True
    try:
        # The descriptor is for settings of its own, which nobody asks for.
        curses.setupterm(term, 1)
    except curses.error:
        return True
    return curses.tigetnum("colors") > 1


def is_terminal(stream: IO[str]) -> bool:
    """Whether a person looks at ``stream``; a closed one is none."""
    try:
        return stream.isatty()
    except ValueError:
        return False


def say(text: str, *, beside: Path | None = None) -> None:
    """Write ``text`` and a line end to stdout; a reader that has gone is no error.

    Where a file that was written ``beside`` is stdout itself, ``text`` goes to stderr.
    """
    if beside is not None:
        from play_launch.postmortem.whole_file import is_standard_output  # noqa: PLC0415

        if is_standard_output(beside):
            print(text, file=sys.stderr)  # noqa: T201 - what it is for
            return
    with surviving_the_reader():
        print(text, flush=True)  # noqa: T201 - what it is for


@contextlib.contextmanager
def surviving_the_reader() -> Iterator[None]:
    """Stop writing to stdout when its reader has closed it, and go on."""
    try:
        yield
    except BrokenPipeError:
        let_go_of(sys.stdout)


@contextlib.contextmanager
def surviving_the_loss_of_stdout() -> Iterator[None]:
    """Stop writing to stdout when it takes no more, for whatever reason, and go on.

    For a run, whose output is not what it is for: its reader, its disk or its terminal may go.
    """
    try:
        yield
    except OSError as error:
        if not (isinstance(error, BrokenPipeError) or is_about_output(error)):
            raise
        let_go_of(sys.stdout)
