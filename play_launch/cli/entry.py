"""Entry point of the command ``play-launch``."""

from __future__ import annotations

import errno
import gc
import io
import os
import signal
import sys
from contextlib import suppress
from typing import IO, Final

OUTPUT_FAILED: Final = 2
"""Exit code if the output could not be written."""
_ESCAPED: Final = "backslashreplace"
_SHORT: Final = frozenset({"check", "dump", "ps"})


def main() -> None:
    """Run the command.

    Until a run takes its signals, Ctrl-C ends the process at once: a KeyboardInterrupt in the
    middle of an import can be swallowed there, and would leave a traceback at best.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    _prepare_standard_streams()
    from play_launch.cli.output import (  # noqa: PLC0415 - after the lines above
        is_about_output,
        redirect_to_devnull,
        report_write_error,
    )

    try:
        _run()
    except OSError as error:
        if is_about_output(error):
            report_write_error(error)
        elif error.filename and error.errno in {errno.EACCES, errno.ENAMETOOLONG}:
            # A name on the command line that cannot even be inspected.
            from play_launch.cli.output import fail  # noqa: PLC0415 - rarely needed

            fail(f"{os.fsdecode(error.filename)}: {error.strerror}")
        elif isinstance(error, FileNotFoundError) and _folder_is_gone():
            from play_launch.cli.output import fail  # noqa: PLC0415 - rarely needed

            fail("the working directory was removed; change to another one")
        else:
            raise
        sys.exit(OUTPUT_FAILED)
    finally:
        try:
            sys.stderr.flush()
        except OSError:  # what could not be written to a closed terminal; Python 3.13 tries again
            redirect_to_devnull(sys.stderr)


def _prepare_standard_streams() -> None:
    """Put the null device in the place of closed streams, and keep stdout for the command.

    A file that is opened later would otherwise get the number and the output of a closed stream.
    A character that the encoding of stdout lacks is written as an escape, as on stderr.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest free number: this one
    for number in (1, 2):
        with suppress(OSError):
            os.set_blocking(number, True)  # another program may have changed it
    sys.stdin = sys.stdin or _null(0, "r")
    sys.stderr = sys.stderr or _null(2, "w")
    stdout = sys.stdout or _null(1, "w")
    assert isinstance(stdout, io.TextIOWrapper)
    stdout.flush()
    # Children do not inherit the copy. Python closes neither this one nor descriptor 1.
    unbuffered = stdout.write_through
    binary = open(os.dup(1), "wb", buffering=0 if unbuffered else -1, closefd=False)  # noqa: SIM115
    os.dup2(2, 1)
    # Python asks the original for the terminal's width.
    sys.stdout = sys.__stdout__ = io.TextIOWrapper(  # type: ignore[misc]
        binary,
        encoding=stdout.encoding,
        errors=_ESCAPED,
        newline="\n",
        line_buffering=stdout.line_buffering,
        write_through=unbuffered,
    )


def _null(number: int, mode: str) -> IO[str]:
    return open(number, mode, encoding="utf-8", errors=_ESCAPED, closefd=False)


def _folder_is_gone() -> bool:
    try:
        os.getcwd()  # noqa: PTH109 - pathlib is slow to import
    except FileNotFoundError:
        return True
    return False


def _run() -> None:
    # Of what is imported and of a configuration nothing becomes garbage: collecting takes a
    # twentieth of the start. `app` and a run enable it again.
    gc.disable()
    stdout = sys.stdout
    from play_launch.cli.app import main as run  # noqa: PLC0415 - after the lines above

    try:
        run()
    except SystemExit as end:
        # Taking Python apart takes up to 30 ms, a fifth of a short command. It would wait for a
        # stdout that was abandoned.
        is_short = len(sys.argv) > 1 and sys.argv[1] in _SHORT
        if isinstance(end.code, int) and (is_short or sys.stdout is not stdout):
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(end.code)
        raise
