"""Files that are made of recordings: each appears when it is whole."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from typing import TYPE_CHECKING, Final

from play_launch.history.file_end import MAGIC

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import FrameType

_ELSEWHERE: Final = "name another file with --output"
_NAME: Final = 50
"""Characters of a name that the unfinished file bears, too; names are limited to 255 bytes."""
_ENDINGS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_unfinished: Final[set[Path]] = set()


class OutputError(Exception):
    """A file cannot be written; the text says where, why, and the fix."""


@contextlib.contextmanager
def whole_file(output: Path) -> Iterator[Path]:
    """Give the path to write to; behind the block, what was written there is at ``output``.

    Nothing is left of a file that was not completed, be it for a full disk or for Ctrl-C.

    Raises:
        OutputError: When it cannot be written, also for an OSError in the block, or would replace
            a recording or something that is no file.
    """
    half = output.parent / f".{output.name[:_NAME]}.{os.getpid()}.writing"
    try:
        _refuse_to_replace(output)
        with _removed_by_signals(half):
            try:
                yield half
                half.replace(output)
            except BaseException:
                half.unlink(missing_ok=True)
                raise
    except OSError as error:
        reason = error.strerror or str(error) or type(error).__name__
        raise OutputError(f"{output}: {reason}; {_ELSEWHERE}") from error


def _refuse_to_replace(output: Path) -> None:
    if output.is_dir():
        raise OutputError(f"{output}: Is a directory; {_ELSEWHERE}")
    if not output.exists():
        return
    if not output.is_file():
        raise OutputError(f"{output}: is no regular file; {_ELSEWHERE}")
    with output.open("rb") as file:
        if file.read(len(MAGIC)) == MAGIC:
            raise OutputError(f"{output}: is a recording; {_ELSEWHERE}")


@contextlib.contextmanager
def _removed_by_signals(path: Path) -> Iterator[None]:
    """Remove the file when a signal that nobody handles ends the process."""
    is_main = threading.current_thread() is threading.main_thread()
    taken = [each for each in _ENDINGS if is_main and signal.getsignal(each) == signal.SIG_DFL]
    _unfinished.add(path)
    for each in taken:
        signal.signal(each, _remove_and_end)
    try:
        yield
    finally:
        for each in taken:
            signal.signal(each, signal.SIG_DFL)
        _unfinished.discard(path)


def _remove_and_end(number: int, _: FrameType | None) -> None:
    for path in _unfinished:
        path.unlink(missing_ok=True)
    signal.signal(number, signal.SIG_DFL)
    signal.raise_signal(number)
