"""Recordings that were cut off become whole ones."""

from __future__ import annotations

import contextlib
import fcntl
import os
from typing import TYPE_CHECKING, NamedTuple

from play_launch.postmortem.archive.folders import DAMAGED, session_entry
from play_launch.postmortem.bag_reader import BagReader, NotARecordingError
from play_launch.postmortem.recover import (
    RecoverError,
    default_output,
    index_folder,
    write_whole,
)
from play_launch.recording.folder import active_parts, open_regular

if TYPE_CHECKING:
    from pathlib import Path

    from play_launch.postmortem.bag_reader import Damage
    from play_launch.postmortem.recover import Recovered


class Completed(NamedTuple):
    """Result for a file."""

    path: Path
    messages: int
    damages: tuple[Damage, ...]
    """What could not be read of it."""
    has_gaps: bool
    """Whether that is more than its end; what it was made of is kept beside then."""


def complete_session(folder: Path) -> list[Completed]:
    """Complete a session in the log folder that was cut off; nothing of one that runs.

    Raises:
        RecoverError: When a file cannot be written.
    """
    entry = session_entry(folder)
    return [] if entry is None or entry.is_running else complete_files(folder)


def complete_files(folder: Path) -> list[Completed]:
    """Complete the files in a folder whose writer is dead, and write its index.

    May be killed and called again at any time. A file that holds nothing is left as it is.

    Raises:
        RecoverError: When a file cannot be written, or the folder cannot be read.
    """
    try:
        active = [part.path for part in active_parts(folder)]
    except OSError as error:
        raise RecoverError(f"{folder}: {error.strerror}") from error
    completed = [one for path in active if (one := _complete(path)) is not None]
    if completed:
        with contextlib.suppress(OSError, NotARecordingError):
            index_folder(folder)
    return completed


def _complete(active: Path) -> Completed | None:
    try:
        source = open_regular(active)
    except OSError:
        return None
    try:
        # Alone: another session may do the same at this moment.
        fcntl.flock(source, fcntl.LOCK_EX | fcntl.LOCK_NB)
        status = os.fstat(source)
        if status.st_nlink == 0:
            return None
        if status.st_size == 0:
            active.unlink()
            return None
        return _replace(active, status)
    except BlockingIOError:
        return None
    except OSError as error:
        raise RecoverError(f"{error.filename or active}: {error.strerror}") from error
    finally:
        os.close(source)


def _replace(active: Path, status: os.stat_result) -> Completed | None:
    output = default_output(active)
    if output.exists():
        if not _is_whole(output):
            return None
        # Killed between the two steps below.
        active.unlink()
        return None
    try:
        recovered = write_whole(active, output)
    except NotARecordingError:
        return None
    os.utime(output, ns=(status.st_atime_ns, status.st_mtime_ns))
    has_gaps = _has_gaps(recovered)
    if has_gaps:
        active.rename(output.with_name(output.name + DAMAGED))
    else:
        active.unlink()
    damages = tuple(recovered.reader.damages)
    return Completed(output, recovered.messages, damages, has_gaps)


def _has_gaps(recovered: Recovered) -> bool:
    """Whether more is missing than what was not written yet when it was cut off."""
    return any(damage.offset < recovered.last_offset for damage in recovered.reader.damages)


def _is_whole(path: Path) -> bool:
    reader = BagReader(path)
    try:
        for _ in reader.messages(()):
            pass
    except NotARecordingError:
        return False
    return reader.is_complete
