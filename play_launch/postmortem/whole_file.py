"""Files that commands write: each appears when it is whole.

Nothing but regular files is replaced: what goes to standard output, a pipe or a device is passed
on when it is whole, and a symbolic link goes on leading to its target.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sys
import tempfile
import threading
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

_ELSEWHERE: Final = "name another file with --output"
_NAME: Final = 50
"""Characters of a name that the unfinished file bears, too; names are limited to 255 bytes."""
_ENDINGS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_STDOUT: Final = frozenset({"-", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"})
_MOST_LINKS: Final = 40
"""Links that the kernel follows."""
_unfinished: Final[set[Path]] = set()


class OutputError(Exception):
    """A file cannot be written; the text says where, why, and the fix."""


@contextlib.contextmanager
def whole_file(output: Path) -> Iterator[Path]:
    """Give the path to write to; behind the block, what was written there is at ``output``.

    ``-`` is standard output, as is what leads to descriptor 1.

    Nothing is left of a file that was not completed, be it for a full disk or for Ctrl-C.

    Raises:
        OutputError: When it cannot be written, also for an OSError in the block, or would replace
            a recording.
    """
    try:
        if is_passed_on(output):
            with _passed_on(output) as file:
                yield file
            return
        _refuse_to_replace(output)
        target = output.resolve() if output.is_symlink() else output
        half = target.parent / f".{target.name[:_NAME]}.{os.getpid()}.writing"
        with _removed_by_signals(half):
            yield half
            half.replace(target)
    except OSError as error:
        reason = error.strerror or str(error) or type(error).__name__
        raise OutputError(f"{output}: {reason}; {_ELSEWHERE}") from error


def is_standard_output(output: Path) -> bool:
    """Whether that means what this process writes to as ``sys.stdout``.

    Descriptor 1 itself leads to standard error, for libraries that write to it.
    """
    return any(step in _STDOUT for step in _steps(output))


def is_passed_on(output: Path) -> bool:
    """Whether that is neither a regular file nor one that is to be made."""
    if output.exists() and not (output.is_file() or output.is_dir()):
        return True
    # Of a descriptor, what it leads to may have no name, or one that has to stay.
    return is_standard_output(output) or any(
        step.startswith(("/proc/", "/dev/fd/")) for step in _steps(output)
    )


def _steps(output: Path) -> Iterator[str]:
    """Give a path, and what it leads to as a symbolic link, step by step."""
    step = str(output)
    for _ in range(_MOST_LINKS):
        yield step
        try:
            step = os.path.join(os.path.dirname(step), os.readlink(step))  # noqa: PTH115, PTH118, PTH120
        except OSError:
            return


@contextlib.contextmanager
def _passed_on(output: Path) -> Iterator[Path]:
    descriptor, name = tempfile.mkstemp(prefix="play_launch-")
    os.close(descriptor)
    with _removed_by_signals(Path(name)):
        yield Path(name)
        with Path(name).open("rb") as whole:
            if is_standard_output(output):
                _write_to_stdout(whole)
            else:
                with output.open("wb") as sink:
                    shutil.copyfileobj(whole, sink)


def _write_to_stdout(whole: IO[bytes]) -> None:
    try:
        shutil.copyfileobj(whole, sys.stdout.buffer)
        sys.stdout.buffer.flush()
    except OSError as error:
        # Python writes what is left at exit, and would fail again.
        with Path(os.devnull).open("wb") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno(), inheritable=False)
        if not isinstance(error, BrokenPipeError):  # a reader that has seen enough is no error
            raise


def _refuse_to_replace(output: Path) -> None:
    if output.is_dir():
        raise OutputError(f"{output}: Is a directory; {_ELSEWHERE}")
    if not output.exists():
        return
    from play_launch.recording.mcap_file import MAGIC  # noqa: PLC0415 - slow, rarely needed

    with output.open("rb") as file:
        if file.read(len(MAGIC)) == MAGIC:
            raise OutputError(f"{output}: is a recording; {_ELSEWHERE}")


@contextlib.contextmanager
def _removed_by_signals(path: Path) -> Iterator[None]:
    """Remove the file, also when a signal that is not handled ends the process."""
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
        path.unlink(missing_ok=True)


def _remove_and_end(number: int, _: FrameType | None) -> None:
    for path in _unfinished:
        path.unlink(missing_ok=True)
    signal.signal(number, signal.SIG_DFL)
    signal.raise_signal(number)
