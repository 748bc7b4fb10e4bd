"""The standard streams of a process that may have been started without some of them.

Standard output belongs to us alone: its readers are programs. But libraries write to descriptor 1
as well; Fast DDS reports its errors there. So what we write goes to a copy of the descriptor, and
descriptor 1 leads to standard error.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
from typing import IO, Final

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
    """Return a stream like ``stdout`` that no library knows; whoever writes to 1 gets stderr."""
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


def let_go_of(stream: IO[str]) -> None:
    """Point a standard stream to nowhere, after it took no more.

    Otherwise Python would fail once more while it flushes at exit, and end with status 120.
    """
    with contextlib.suppress(OSError, ValueError):
        number = stream.fileno()
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, number, inheritable=number == 2)
        os.close(nowhere)


def is_about_output(error: OSError) -> bool:
    """Whether an error says that a stream takes no more: a full disk, a terminal that is gone."""
    return error.errno in _TAKES_NO_MORE and error.filename is None


def give_up_output(error: OSError) -> None:
    """Report on stderr, if that takes it, that stdout takes no more; the command cannot go on."""
    let_go_of(sys.stdout)
    try:
        sys.stderr.write(f"error: cannot write the output: {error.strerror}\n")
        sys.stderr.flush()
    except OSError:
        let_go_of(sys.stderr)
