"""The only writer of the commands: streams, errors, foreign text, figures, times, tables, files.

Standard output belongs to the command: its readers are programs. Libraries write to descriptor 1,
too (Fast DDS reports its errors there), so a copy of the descriptor is used, and descriptor 1
leads to standard error.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import sys
import time
from itertools import zip_longest
from typing import IO, TYPE_CHECKING, Final, NoReturn

from play_launch import UserError
from play_launch.config.text import counted as counted  # noqa: PLC0414 - for all of cli
from play_launch.config.text import duration as duration  # noqa: PLC0414
from play_launch.config.text import size as size  # noqa: PLC0414

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path
    from types import FrameType

_UNWRITABLE: Final = frozenset(
    {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF, errno.ENXIO}
)

# Standard streams.


def stdout_is_kept() -> bool:
    """Whether the command writes to another descriptor than 1."""
    with contextlib.suppress(OSError, ValueError):
        return sys.stdout.fileno() != 1
    return False


def redirect_to_devnull(stream: IO[str]) -> None:
    """Point a standard stream to the null device after a write failed.

    Otherwise Python would fail once more while it flushes at exit, and end with status 120.
    """
    with contextlib.suppress(OSError, ValueError):
        number = stream.fileno()
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, number, inheritable=number == 2)
        os.close(null)


def abandon_stdout() -> None:
    """Put the null device in the place of a stdout that takes nothing.

    A thread that waits for it holds its lock: each other write, and Python's own flush at the end,
    would wait as long.
    """
    sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115, PTH123 - until the end


def is_about_output(error: OSError) -> bool:
    """Whether a stream cannot be written: a full disk, a closed terminal."""
    return error.errno in _UNWRITABLE and error.filename is None


def report_write_error(error: OSError) -> None:
    """Report on stderr, if possible, that stdout cannot be written."""
    redirect_to_devnull(sys.stdout)
    try:
        report(f"cannot write the output: {error.strerror}")
    except OSError:
        redirect_to_devnull(sys.stderr)


# Terminals and foreign text.

RESET: Final = "\x1b[0m"
RED: Final = "\x1b[31m"
YELLOW: Final = "\x1b[33m"
GREEN: Final = "\x1b[32m"
BOLD: Final = "\x1b[1m"
_COLOUR: Final = re.compile(r"\x1b\[[0-9;]*m")
_CONTROL: Final = re.compile(
    r"\x1b\[[0-?]*[ -/]*[@-~]"  # CSI: moves the cursor, erases, sets modes
    r"|\x1b\][^\x07\x1b]*(?:\x07|\x1b\\)?"  # OSC: sets titles, writes clipboards
    r"|\x1b[PX^_][^\x1b]*(?:\x1b\\)?"  # DCS and its like
    r"|\x1b."
    r"|[\x00-\x08\x0b-\x1f\x7f\x80-\x9f"
    r"\u2028-\u202e\u2066-\u2069]"  # ends lines, turns the direction of the text that follows
)


def printable(text: str, *, colour: bool = False) -> str:
    """Remove from foreign text what would disturb a terminal.

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
    return is_terminal(stream) and _has_colours(os.environ.get("TERM", ""))


def _has_colours(term: str) -> bool:
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


# Lines.


def say(text: str, *, beside: Path | None = None) -> None:
    """Write ``text`` and a line end to stdout; a reader that has gone is no error.

    Where a file that was written ``beside`` is stdout itself, ``text`` goes to stderr.
    """
    if beside is not None and is_standard_output(beside):
        note(text)
        return
    try:
        print(text, flush=True)  # noqa: T201 - what it is for
    except BrokenPipeError:
        redirect_to_devnull(sys.stdout)


def say_live(text: str) -> None:
    """Write ``text`` and a line end to stdout, for the last time if that fails: the run goes on."""
    try:
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()
    except OSError as error:
        if not (isinstance(error, BrokenPipeError) or is_about_output(error)):
            raise
        redirect_to_devnull(sys.stdout)


def fail(message: str, code: int = 2) -> NoReturn:
    report(message)
    sys.exit(code)


def report(message: str) -> None:
    _write_labelled("error:", "\x1b[1;31m", message)


def warn(message: str) -> None:
    _write_labelled("warning:", YELLOW, message)


def note(text: str) -> None:
    # Names of files and their content may hold any character.
    print(printable(text), file=sys.stderr, flush=True)  # noqa: T201 - what it is for


def _write_labelled(label: str, colour: str, message: str) -> None:
    if wants_colour(sys.stderr):
        label = f"{colour}{label}{RESET}"
    print(f"{label} {printable(message)}", file=sys.stderr, flush=True)  # noqa: T201 - as above


# Tables.


def table(
    titles: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    words: int = 1,
    width: int | None = None,
) -> list[str]:
    """Lay out rows in columns; colours in cells take no room.

    The first ``words`` columns and the last one are flush left, the others hold numbers. The last
    cell is cut where a terminal of that ``width`` ends.
    """
    cells = [titles, *rows]
    widths = [max(len(printable(line[at])) for line in cells) for at in range(len(titles) - 1)]
    room = None if width is None else max(width - sum(widths) - 2 * len(widths), 20)
    lines = []
    for line in cells:
        laid = []
        for at, (cell, most) in enumerate(zip_longest(line, widths, fillvalue=0)):
            gap = " " * (int(most) - len(printable(str(cell))))
            laid.append(f"{cell}{gap}" if at < words or at == len(widths) else f"{gap}{cell}")
        if room is not None and len(line[-1]) > room:
            laid[-1] = f"{line[-1][: room - 3]}..."
        lines.append("  ".join(laid).rstrip())
    return lines


# Times.

_CLOCK: Final = re.compile(r"([01]?\d|2[0-3]):([0-5]\d)(?::([0-5]\d(?:\.\d+)?))?")


def clock(stamp_ns: int, form: str = "%H:%M:%S.%3N") -> str:
    """Write the local time; ``%3N`` in the form are its milliseconds."""
    seconds, rest = divmod(stamp_ns, 10**9)
    return time.strftime(form.replace("%3N", f"{rest // 10**6:03}"), time.localtime(seconds))


def clock_times(text: str, near: float) -> list[float]:
    """List when the clock shows ``14:03`` or ``14:03:07``, one day around ``near``.

    Times are seconds since the epoch; there are none for any other text.
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


# Files. Each appears when it is whole. Nothing but regular files is replaced: a pipe or a device
# gets the whole content, and a symbolic link continues to lead to its target.

_STDOUT: Final = frozenset({"-", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"})
_LINKS_LIMIT: Final = 40
"""Links that the kernel follows."""
_unfinished: Final[set[Path]] = set()


class OutputError(UserError):
    """A file cannot be written; the text has the file, the cause and the fix."""

    exit_code = 1

    def __init__(self, output: Path, reason: str) -> None:
        super().__init__(f"{output}: {reason}; name another file with --output")


@contextlib.contextmanager
def whole_file(output: Path, *, replaces_recording: bool = False) -> Iterator[Path]:
    """Provide the path to write to; after the block, its content is at ``output``.

    Nothing is left of a file that was not completed because of a full disk or Ctrl-C. ``-`` is
    standard output, as is what leads to descriptor 1.

    Raises OutputError when it cannot be written, also for an OSError in the block, or would replace
    a recording and is not to.
    """
    import tempfile  # noqa: PLC0415 - not for verbs without a file
    from pathlib import Path  # noqa: PLC0415

    try:
        if is_passed_on(output):
            descriptor, name = tempfile.mkstemp(prefix="play_launch-")
            os.close(descriptor)
            with _removed_by_signals(Path(name)):
                yield Path(name)
                _pass_on(Path(name), output)
            return
        if not replaces_recording:
            _refuse_to_replace(output)
        target = output.resolve() if output.is_symlink() else output
        # Names are limited to 255 bytes.
        half = target.parent / f".{target.name[:50]}.{os.getpid()}.writing"
        with _removed_by_signals(half):
            yield half
            half.replace(target)
    except OSError as error:
        raise OutputError(output, error.strerror or str(error) or type(error).__name__) from error


def make_folder(folder: Path) -> None:
    """Make the folder of an output, unless it is there; raises OutputError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(folder, error.strerror or str(error)) from error


def write_file(output: Path, content: str | bytes) -> int:
    """Write a whole file, as `whole_file` does, and return its size in bytes."""
    data = content if isinstance(content, bytes) else content.encode()
    with whole_file(output) as file:
        file.write_bytes(data)
    return len(data)


def is_standard_output(output: Path) -> bool:
    """Whether that is what this process writes to as ``sys.stdout``; descriptor 1 is stderr."""
    return any(step in _STDOUT for step in _steps(output))


def is_passed_on(output: Path) -> bool:
    """Whether that is neither a regular file nor one that is to be made."""
    if output.exists() and not (output.is_file() or output.is_dir()):
        return True
    # The target of a descriptor may have no name, or one that has to stay.
    return is_standard_output(output) or any(
        step.startswith(("/proc/", "/dev/fd/")) for step in _steps(output)
    )


def _steps(output: Path) -> Iterator[str]:
    """Yield a path, and the targets of its symbolic links, step by step."""
    step = str(output)
    for _ in range(_LINKS_LIMIT):
        yield step
        try:
            step = os.path.join(os.path.dirname(step), os.readlink(step))  # noqa: PTH115, PTH118, PTH120
        except OSError:
            return


def _pass_on(whole: Path, output: Path) -> None:
    import shutil  # noqa: PLC0415 - as above

    with whole.open("rb") as content:
        if not is_standard_output(output):
            with output.open("wb") as sink:
                shutil.copyfileobj(content, sink)
            return
        try:
            shutil.copyfileobj(content, sys.stdout.buffer)
            sys.stdout.buffer.flush()
        except OSError as error:
            redirect_to_devnull(sys.stdout)
            if not isinstance(error, BrokenPipeError):  # a reader that closed early is no error
                raise


def _refuse_to_replace(output: Path) -> None:
    if output.is_dir():
        raise OutputError(output, "Is a directory")
    if not output.exists():
        return
    from play_launch.recording.folder import MAGIC  # noqa: PLC0415 - slow, rarely needed

    with output.open("rb") as file:
        if file.read(len(MAGIC)) == MAGIC:
            raise OutputError(output, "is a recording")


@contextlib.contextmanager
def _removed_by_signals(path: Path) -> Iterator[None]:
    """Remove the file, also when a signal without a handler ends the process."""
    import signal  # noqa: PLC0415 - as above
    import threading  # noqa: PLC0415

    def remove_and_end(number: int, _: FrameType | None) -> None:
        for each in _unfinished:
            each.unlink(missing_ok=True)
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)

    is_main = threading.current_thread() is threading.main_thread()
    endings = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    handled = [each for each in endings if is_main and signal.getsignal(each) == signal.SIG_DFL]
    _unfinished.add(path)
    for each in handled:
        signal.signal(each, remove_and_end)
    try:
        yield
    finally:
        for each in handled:
            signal.signal(each, signal.SIG_DFL)
        _unfinished.discard(path)
        path.unlink(missing_ok=True)
