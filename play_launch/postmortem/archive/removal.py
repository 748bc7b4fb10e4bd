"""Removes the folder of a session, and nothing else."""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING

from play_launch.postmortem.archive.folders import REMOVING, is_own_file, is_tables, session_entry

if TYPE_CHECKING:
    from pathlib import Path


def remove_session(folder: Path) -> bool:
    """Remove a session that neither runs nor is pinned; return whether it is gone.

    The folder gets another name first: readers find all of it or nothing, and a removal that
    was killed is finished by `finish_removals`. No link is followed. May raise ``OSError``.
    """
    entry = session_entry(folder)
    if entry is None or entry.is_running or entry.is_pinned:
        return False
    going = folder.with_name(REMOVING + folder.name)
    folder.rename(going)
    if _empty(going):
        return True
    # A file was added there in the meantime.
    going.rename(folder)
    return False


def finish_removals(log_folder: Path) -> None:
    """Remove what is left of folders whose removal was killed.

    May raise ``OSError``, after it has tried all.
    """
    with os.scandir(log_folder) as entries:
        names = [
            entry.name
            for entry in entries
            if entry.name.startswith(REMOVING) and entry.is_dir(follow_symlinks=False)
        ]
    failed = None
    for name in names:
        try:
            _empty(log_folder / name)
        except OSError as error:
            failed = error
    if failed is not None:
        raise failed


def _empty(folder: Path) -> bool:
    # By its descriptor: if the name comes to mean another folder, that one is left alone.
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        names = os.listdir(descriptor)  # noqa: PTH208 - of a descriptor
        tables = [name for name in names if is_tables(folder / name)]
        files = [name for name in names if name not in tables]
        if not all(is_own_file(folder / name) for name in files):
            return False
        for name in files:
            os.unlink(name, dir_fd=descriptor)
        if not all(_empty(folder / name) for name in tables):
            return False
    finally:
        os.close(descriptor)
    with contextlib.suppress(OSError):
        folder.rmdir()
        return True
    return False
