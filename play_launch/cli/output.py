"""What the commands write: the standard streams, errors, foreign text, sizes, times.

Standard output belongs to the command: its readers are programs. Libraries write to descriptor 1,
too (Fast DDS reports its errors there), so a copy of the descriptor is used, and descriptor 1
leads to standard error.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import re
import sys
import time
from typing import IO, TYPE_CHECKING, Any, Final, NoReturn

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

_TAKES_NO_MORE: Final = frozenset(
    {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF, errno.ENXIO}
)
_ESCAPED: Final = "backslashreplace"


def prepare_standard_streams() -> None:
    """Put the null device in the place of closed streams, and keep stdout for what we write.

    A file that is opened later would otherwise get the number of a closed stream, and with it
    whatever is written there; Python has no stream object then either. A character that the
    encoding of stdout lacks is written as an escape, as on stderr.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest free number: this one
    sys.stdin = sys.stdin or _null(0, "r")
    sys.stdout = sys.stdout or _null(1, "w")
    sys.stderr = sys.stderr or _null(2, "w")
    sys.stdout = kept = _kept_to_ourselves(sys.stdout)
    # The terminal's width is asked of the original.
    sys.__stdout__ = kept  # type: ignore[misc]


def _kept_to_ourselves(stdout: IO[str]) -> io.TextIOWrapper:
    """Return a stream like ``stdout`` unknown to libraries; writes to descriptor 1 go to stderr."""
    assert isinstance(stdout, io.TextIOWrapper)
    stdout.flush()
    # Children do not inherit the copy. Python closes neither this one nor descriptor 1.
    unbuffered = stdout.write_through
    binary = open(os.dup(1), "wb", buffering=0 if unbuffered else -1, closefd=False)  # noqa: SIM115
    os.dup2(2, 1)
    return io.TextIOWrapper(
        binary,
        encoding=stdout.encoding,
        errors=_ESCAPED,
        newline="\n",
        line_buffering=stdout.line_buffering,
        write_through=unbuffered,
    )


def stdout_is_kept() -> bool:
    """Whether what we write goes to another descriptor than 1."""
    with contextlib.suppress(OSError, ValueError):
        return sys.stdout.fileno() != 1
    return False


def _null(number: int, mode: str) -> IO[str]:
    return open(number, mode, encoding="utf-8", errors=_ESCAPED, closefd=False)


def redirect_to_devnull(stream: IO[str]) -> None:
    """Point a standard stream to the null device after a write failed.

    Otherwise Python would fail once more while it flushes at exit, and end with status 120.
    """
    with contextlib.suppress(OSError, ValueError):
        number = stream.fileno()
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, number, inheritable=number == 2)
        os.close(nowhere)


def is_about_output(error: OSError) -> bool:
    """Whether a stream cannot be written: a full disk, a closed terminal."""
    return error.errno in _TAKES_NO_MORE and error.filename is None


def report_write_error(error: OSError) -> None:
    """Report on stderr, if possible, that stdout cannot be written."""
    redirect_to_devnull(sys.stdout)
    try:
        sys.stderr.write(f"error: cannot write the output: {error.strerror}\n")
        sys.stderr.flush()
    except OSError:
        redirect_to_devnull(sys.stderr)


# Terminals and foreign text.

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
    """Whether to colour what goes to ``stream``: a terminal with colours, and no NO_COLOR.

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
        # The descriptor is only used for terminal settings, which are not read here.
        curses.setupterm(term, 1)
    except curses.error:
        return True
    return curses.tigetnum("colors") > 1


def is_terminal(stream: IO[str]) -> bool:
    """Whether ``stream`` is a terminal; a closed stream is not."""
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
        redirect_to_devnull(sys.stdout)


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
        redirect_to_devnull(sys.stdout)


# Errors.


def fail(message: str, code: int = 2) -> NoReturn:
    """Report an error on stderr and exit with ``code``."""
    report(message)
    sys.exit(code)


def report(message: str) -> None:
    """Write ``error: message`` to stderr; several lines keep their form.

    Names of files and what stands in them may hold anything.
    """
    label = "\x1b[1;31merror:\x1b[0m" if wants_colour(sys.stderr) else "error:"
    print(f"{label} {printable(message, colour=False)}", file=sys.stderr, flush=True)  # noqa: T201 - what it is for


# Sizes and times.

_BYTES: Final = (("GB", 1_000_000_000), ("MB", 1_000_000), ("kB", 1_000))


def size(count: int) -> str:
    """Write a number of bytes for people, in powers of ten."""
    for unit, factor in _BYTES:
        if count >= factor:
            return f"{count / factor:.3g} {unit}"
    return f"{count} bytes"


_SECOND: Final = 1_000_000_000
_CLOCK: Final = re.compile(r"([01]?\d|2[0-3]):([0-5]\d)(?::([0-5]\d(?:\.\d+)?))?")


def duration(nanoseconds: int) -> str:
    """Write a time for people: ``0.8 s``, ``12 s``, ``3 min 20 s``, ``2 h 5 min``."""
    seconds = nanoseconds / _SECOND
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole // 60 % 60} min"


def clock_times(text: str, near: float) -> list[float]:
    """List when the clock shows ``14:03`` or ``14:03:07``: the day before, that day, the next.

    Args:
        text: What was typed; there are none when it is something else.
        near: A time of that day; it and the result are seconds since the epoch.
    """
    clock = _CLOCK.fullmatch(text)
    if clock is None:
        return []
    year, month, day = time.localtime(near)[:3]
    hour, minute, seconds = int(clock[1]), int(clock[2]), float(clock[3] or 0)
    return [
        time.mktime((year, month, day + days, hour, minute, 0, 0, 0, -1)) + seconds
        for days in (-1, 0, 1)
    ]


def lines_of(event: Mapping[str, Any]) -> str:
    """Write an event of the control socket; a text of several lines stays."""
    source = str(event["source"])
    text = str(event["text"]) + (" [cut]" if event.get("truncated") else "")
    clean = printable(text, colour=False).replace("\n", f"\n{' ' * 13}")
    return f"{clock(event.get('stamp_ns', 0))} [{printable(source, colour=False)}] {clean}"


def clock(stamp_ns: int) -> str:
    """Write the local time of day to the millisecond."""
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    return f"{time.strftime('%H:%M:%S', time.localtime(seconds))}.{rest // 1_000_000:03}"
