"""The standard streams of a process that may have been started without some of them."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from typing import IO, Final

_TAKES_NO_MORE: Final = frozenset(
    {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF, errno.ENXIO}
)
_ESCAPED: Final = "backslashreplace"


def prepare_standard_streams() -> None:
    """Put the null device in the place of closed streams, and let stdout take every character.

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
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors=_ESCAPED)


def _null(number: int, mode: str) -> IO[str]:
    return open(number, mode, encoding="utf-8", errors=_ESCAPED, closefd=False)


def let_go_of(stream: IO[str]) -> None:
    """Point a standard stream to nowhere, after it took no more.

    Otherwise Python would fail once more while it flushes at exit, and end with status 120.
    """
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
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
