"""Which folders are sessions that play-launch recorded, and what holds for each."""

from __future__ import annotations

import fcntl
import os
import re
import stat
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.control.registration import CONTROL_SOCKET
from play_launch.recording.folder import (
    ACTIVE_SUFFIX,
    HALF_SUFFIX,
    INDEX_NAME,
    NEW_SUFFIX,
    age_in,
    open_regular,
    part_file,
)

if TYPE_CHECKING:
    from pathlib import Path

REMOVING: Final = ".removing-"
"""Before the name of a folder that is being removed."""
DAMAGED: Final = ".damaged"
"""After the name of a file from which one was recovered that has gaps."""

_MADE: Final = (".html", ".trace.json")
"""Endings of what `report` and `export` make beside a recording; it can be made again."""
_TABLES: Final = re.compile(r"session(_\d+)?-(csv|parquet)", re.ASCII)
"""A folder with tables, which `export` makes there, too."""
_TABLE: Final = re.compile(r"(processes|cgroups|machine|states)\.(csv|parquet)")
_HALF: Final = re.compile(r"\.(.+)\.\d+\.writing", re.ASCII | re.DOTALL)
"""What `history.whole_file` leaves when it is killed."""
_OWN: Final = frozenset({INDEX_NAME, INDEX_NAME + NEW_SUFFIX, CONTROL_SOCKET})
_NAME: Final = re.compile(r"\d{4}(?:-\d\d){5}-.+", re.ASCII | re.DOTALL)
"""As `recording.session` names the folder of a session."""
_HEAD: Final = re.compile(rb"\x89MCAP0\r\n\x01.{8}\x04\0\0\0ros2.{4}play_launch", re.DOTALL)
"""How a file begins that play-launch wrote: the header names profile and library."""
_HEAD_SIZE: Final = 64


class SessionEntry(Struct, frozen=True):
    """The folder of a session."""

    name: str
    """Its beginning is the local time of its start, by the clock as it was."""
    size: int
    """Bytes of its files."""
    is_running: bool = False
    others: tuple[str, ...] = ()
    """What lies in it and is not play-launch's; it keeps the folder."""
    active: tuple[str, ...] = ()
    """Files that were not completed."""

    @property
    def is_pinned(self) -> bool:
        """Whether it holds files of other programs."""
        return bool(self.others)


def list_sessions(log_folder: Path) -> list[SessionEntry]:
    """The sessions in a log folder, the oldest first; those that are none are left out."""
    try:
        with os.scandir(log_folder) as entries:
            names = [
                entry.name
                for entry in entries
                if _NAME.fullmatch(entry.name) and entry.is_dir(follow_symlinks=False)
            ]
    except OSError:
        return []
    found = (session_entry(log_folder / name) for name in sorted(names, key=age_in(log_folder)))
    return [entry for entry in found if entry is not None]


def session_entry(folder: Path) -> SessionEntry | None:
    """Look into a folder; None when it is no session that we recorded, or cannot be read."""
    if not _NAME.fullmatch(folder.name) or folder.is_symlink():
        return None
    size = 0
    is_ours = is_running = False
    others: list[str] = []
    active: list[str] = []
    try:
        with os.scandir(folder) as entries:
            for entry in sorted(entries, key=lambda each: each.name):
                status = entry.stat(follow_symlinks=False)
                size += status.st_blocks * 512
                if entry.name == CONTROL_SOCKET and stat.S_ISSOCK(status.st_mode):
                    continue
                if is_tables(folder / entry.name):
                    continue
                if not stat.S_ISREG(status.st_mode) or not is_own_file(folder / entry.name):
                    others.append(entry.name)
                    continue
                part = part_file(folder / entry.name)
                if part is None:
                    continue
                is_new = part.is_active and status.st_size == 0
                is_ours = is_ours or is_new or _is_recording(part.path)
                if part.is_active:
                    active.append(entry.name)
                    is_running = is_running or is_being_written(part.path)
    except OSError:
        return None
    if not is_ours:
        return None
    return SessionEntry(folder.name, size, is_running, tuple(others), tuple(active))


def is_own_file(path: Path) -> bool:
    """Whether it has a name that play-launch gives."""
    if half := _HALF.fullmatch(path.name):
        path = path.with_name(half[1])
    if _TABLES.fullmatch(path.parent.name):
        return _TABLE.fullmatch(path.name) is not None
    for suffix in (HALF_SUFFIX, DAMAGED):
        path = path.with_name(path.name.removesuffix(suffix))
    for suffix in _MADE:
        if path.name.endswith(suffix):
            path = path.with_name(f"{path.name.removesuffix(suffix)}.mcap")
    return path.name in _OWN or part_file(path) is not None


def is_tables(path: Path) -> bool:
    """Whether it is a folder with nothing but tables; may raise ``OSError``."""
    if not _TABLES.fullmatch(path.name) or path.is_symlink() or not path.is_dir():
        return False
    with os.scandir(path) as entries:
        return all(
            each.is_file(follow_symlinks=False) and is_own_file(path / each.name)
            for each in entries
        )


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


def _is_recording(path: Path) -> bool:
    try:
        descriptor = open_regular(path)
    except OSError:
        return False
    try:
        return _HEAD.match(os.read(descriptor, _HEAD_SIZE)) is not None
    except OSError:
        return False
    finally:
        os.close(descriptor)
