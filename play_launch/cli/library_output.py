"""What libraries of this process write to standard output, as records of the log.

In the middle of a run, on a terminal, they would write across the live view, and their words would
be missing from the recording. Before the run and after it they come out on standard error.
"""

from __future__ import annotations

import contextlib
import logging
import os
from typing import TYPE_CHECKING, Final

from play_launch.cli.output import printable, stdout_is_kept
from play_launch.process.lines import LineReader

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from play_launch.process.lines import Line

_MUCH: Final = 32 * 1024
"""Bytes of one read from which on the pipe may have been full: it holds 64 KiB, or half of that
where the pieces fit badly."""

_log = logging.getLogger(__name__)


@contextlib.contextmanager
def library_output_logged() -> Iterator[None]:
    """Log each line that libraries write to descriptor 1, within a running event loop.

    Whoever finds the pipe full loses what he writes: he may hold the interpreter's lock, and would
    wait for us for ever. That something may be missing is logged as well.
    """
    if not stdout_is_kept():
        yield
        return
    before = os.dup(1)
    read, write = os.pipe()
    os.set_blocking(write, False)
    reader = LineReader(read, _log_lines)
    os.dup2(write, 1)
    os.close(write)
    try:
        yield
    finally:
        os.dup2(before, 1)
        os.close(before)
        reader.close()


def _log_lines(lines: Sequence[Line]) -> None:
    for line in lines:
        text = printable(line.text, colour=False).strip()
        if text:
            cut = " [cut]" if line.truncated else ""
            _log.warning("a library of the supervisor writes: %s%s", text, cut)
    if sum(len(line.text) for line in lines) > _MUCH:
        _log.warning("libraries of the supervisor write so much that lines may be missing here")
