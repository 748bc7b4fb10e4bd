"""A program whose execution takes long, as from the disk of a slow server."""

from __future__ import annotations

import fcntl
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def slow_to_execute(program: Path) -> Iterator[Callable[[], bool]]:
    """Keep execve(2) of a program waiting until the block ends, or 45 s at the most.

    By a lease of the file, see fcntl(2). Yields a function that tells whether an execution waits.
    To be called in the main thread.
    """
    waiting = []
    before = signal.signal(signal.SIGIO, lambda *_: waiting.append(True))
    # Open for reading: close(2) ends a lease before it ends the write access, and the execution
    # that goes on between the two fails with ETXTBSY.
    file = os.open(program, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_WRLCK)
        yield lambda: bool(waiting)
    finally:
        os.close(file)
        signal.signal(signal.SIGIO, before)
