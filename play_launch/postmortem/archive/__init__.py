"""Earlier sessions in a log folder: those that were cut off are completed, the oldest removed.

``python -m play_launch.postmortem.archive`` does both, once, at the lowest priority.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import os
import re
import shutil
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from msgspec import Struct

from play_launch.config.model import KeepConfig
from play_launch.postmortem.bag_reader import BagReader, NotARecordingError
from play_launch.postmortem.recover import (
    RecoverError,
    default_output,
    index_folder,
    write_whole,
)
from play_launch.recording.folder import (
    ACTIVE_SUFFIX,
    active_parts,
    age_in,
    is_own,
    open_regular,
    part_file,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from play_launch.postmortem.bag_reader import Damage

REMOVING: Final = ".removing-"
"""Before the name of a folder that is being removed."""
DAMAGED: Final = ".damaged"
"""After the name of a file from which one was recovered that has gaps."""
_NAME: Final = re.compile(r"\d{4}(?:-\d\d){5}-.+", re.ASCII | re.DOTALL)
"""As `recording.session` names the folder of a session."""
_HEAD: Final = re.compile(rb"\x89MCAP0\r\n\x01.{8}\x04\0\0\0ros2.{4}play_launch", re.DOTALL)
"""How a file begins that play-launch wrote: the header names profile and library."""
_HEAD_SIZE: Final = 64
_TIME_LIMIT: Final = 600.0
"""Seconds after which no further file is begun; the next start continues."""
_UNITS: Final = 1_000_000


class SessionEntry(Struct, frozen=True):
    """The folder of a session."""

    name: str
    """Its beginning is the local time of its start, by the clock as it was."""
    size: int
    """Bytes of its files."""
    is_running: bool = False
    is_pinned: bool = False
    """Whether it holds files of other programs."""
    active: tuple[str, ...] = ()
    """Files that were not completed."""


class Completed(NamedTuple):
    """A file that was cut off, and is whole."""

    path: Path
    messages: int
    damages: tuple[Damage, ...]
    """What could not be read of it."""
    has_gaps: bool
    """Whether that is more than its end; its source is kept beside it then."""


def list_sessions(log_folder: Path) -> list[SessionEntry]:
    """Return the sessions in a log folder, the oldest first; other folders are left out."""
    try:
        names = [path.name for path in log_folder.iterdir()]
    except OSError:
        return []
    found = (session_entry(log_folder / name) for name in sorted(names, key=age_in(log_folder)))
    return [entry for entry in found if entry is not None]


def session_entry(folder: Path) -> SessionEntry | None:
    """Look into a folder; None when it is no session that play-launch recorded."""
    if not _NAME.fullmatch(folder.name) or folder.is_symlink() or not folder.is_dir():
        return None
    size, is_ours, is_running, is_pinned, active = 0, False, False, False, list[str]()
    try:
        for path in sorted(folder.iterdir()):
            status = path.stat(follow_symlinks=False)
            size += status.st_blocks * 512
            is_pinned = is_pinned or not is_own(path)
            part = part_file(path)
            if part is None or path.is_symlink():
                continue
            is_new = part.is_active and status.st_size == 0
            is_ours = is_ours or is_new or _is_recording(path)
            if part.is_active:
                active.append(path.name)
                is_running = is_running or is_being_written(path)
    except OSError:
        return None
    if not is_ours:
        return None
    return SessionEntry(folder.name, size, is_running, is_pinned, tuple(active))


def is_being_written(path: Path) -> bool:
    """Whether its writer lives, which holds a lock; so too when that cannot be found out."""
    try:
        descriptor = open_regular(path)
    except FileNotFoundError:
        # Completed since the folder was read, by its writer.
        return path.name.endswith(ACTIVE_SUFFIX)
    except OSError:
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(descriptor)
    return False


def sessions_to_remove(
    sessions: Sequence[SessionEntry], keep: KeepConfig
) -> tuple[SessionEntry, ...]:
    """Of sessions, the oldest first, those to remove; none that runs, and none that is pinned.

    Limits hold for all that are not pinned, running ones included. Those may exceed them.
    """
    counted = [one for one in sessions if not one.is_pinned]
    count, size = len(counted), sum(one.size for one in counted)
    removed: list[SessionEntry] = []
    for session in counted:
        fits = (keep.sessions is None or count <= keep.sessions) and (
            keep.size is None or size <= keep.size
        )
        if fits:
            break
        if not session.is_running:
            removed.append(session)
            count, size = count - 1, size - session.size
    return tuple(removed)


def remove_session(folder: Path) -> bool:
    """Remove a session that neither runs nor is pinned; return whether it is gone.

    It is renamed first: readers find all of it or nothing, and the next run finishes a removal that
    was killed. No link is followed. May raise ``OSError``.
    """
    entry = session_entry(folder)
    if entry is None or entry.is_running or entry.is_pinned:
        return False
    trash = folder.rename(folder.with_name(REMOVING + folder.name))
    if not all(is_own(path) for path in trash.iterdir()):
        trash.rename(folder)  # a file was added in the meantime
        return False
    shutil.rmtree(trash)
    return True


def complete_session(folder: Path) -> list[Completed]:
    """Complete a session in the log folder that was cut off; nothing of one that runs."""
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
        output = default_output(active)
        if status.st_size == 0 or (output.exists() and _is_whole(output)):
            active.unlink()  # it was killed before its first byte, or before this step
            return None
        if output.exists():
            return None
        recovered = write_whole(active, output)
        os.utime(output, ns=(status.st_atime_ns, status.st_mtime_ns))
        damages = tuple(recovered.reader.damages)
        # Not what was not written yet when it was cut off.
        has_gaps = any(damage.offset < recovered.last_offset for damage in damages)
        if has_gaps:
            active.rename(output.with_name(output.name + DAMAGED))
        else:
            active.unlink()
        return Completed(output, recovered.messages, damages, has_gaps)
    except (BlockingIOError, NotARecordingError):
        return None
    except OSError as error:
        raise RecoverError(f"{error.filename or active}: {error.strerror}") from error
    finally:
        os.close(source)


def _is_whole(path: Path) -> bool:
    reader = BagReader(path)
    with contextlib.suppress(NotARecordingError):
        for _ in reader.messages(()):
            pass
    return reader.is_complete


def _is_recording(path: Path) -> bool:
    try:
        with os.fdopen(open_regular(path), "rb") as file:
            return _HEAD.match(file.read(_HEAD_SIZE)) is not None
    except OSError:
        return False


def main() -> int:
    """Remove what exceeds the limits, complete what was cut off; print a line for each."""
    import psutil  # noqa: PLC0415 - takes a while

    parser = argparse.ArgumentParser(prog="python -m play_launch.postmortem.archive")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--keep-sessions", type=int)
    parser.add_argument("--keep-size", type=int)
    arguments = parser.parse_args()
    os.nice(19)
    with contextlib.suppress(OSError):
        psutil.Process().ionice(psutil.IOPRIO_CLASS_IDLE)
    errors: list[str] = []
    keep = KeepConfig(arguments.keep_sessions, arguments.keep_size)
    remove(arguments.folder, keep, errors)
    complete(arguments.folder, errors)
    for error in errors:
        print(f"warning: {error}")  # noqa: T201 - read by the supervisor
    return 1 if errors else 0


def remove(log_folder: Path, keep: KeepConfig, errors: list[str]) -> None:
    """Finish removals that were killed, and remove the sessions beyond the limits."""
    removed = []
    for trash in log_folder.glob(f"{REMOVING}*"):
        try:
            if not trash.is_symlink():
                shutil.rmtree(trash)
        except OSError as error:
            errors.append(f"{trash} cannot be removed: {error.strerror}")
    for one in sessions_to_remove(list_sessions(log_folder), keep):
        try:
            if remove_session(log_folder / one.name):
                removed.append(one)
        except OSError as error:
            errors.append(f"{log_folder / one.name} cannot be removed: {error.strerror}")
    if removed:
        size = sum(one.size for one in removed) / _UNITS
        print(  # noqa: T201 - as above
            f"info: removed {_sessions(len(removed))} ({size:,.1f} MB) from {log_folder}, "
            f"the latest of them {removed[-1].name}"
        )


def complete(log_folder: Path, errors: list[str]) -> None:
    deadline = time.monotonic() + _TIME_LIMIT
    completed: list[Completed] = []
    for entry in list_sessions(log_folder):
        if entry.active and time.monotonic() < deadline:
            try:
                completed += complete_session(log_folder / entry.name)
            except RecoverError as error:
                errors.append(str(error))
    if not completed:
        return
    messages = sum(one.messages for one in completed)
    sessions = {one.path.parent.name for one in completed}
    line = (
        f"warning: recovered the recording of {_sessions(len(sessions))} that did not end in order "
        f"({messages:,} messages): {', '.join(sorted(sessions))}"
    )
    if gaps := sum(one.has_gaps for one in completed):
        line += f"; parts are damaged in {gaps} files, which are kept as .damaged"
    print(line)  # noqa: T201 - as above


def _sessions(count: int) -> str:
    return f"{count} session" if count == 1 else f"{count} sessions"
