"""The folder for temporary files of an evaluation, and those that killed evaluations have left."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

_PREFIX: Final = "play_launch_evaluation_"
_AGE: Final = 60.0
"""Seconds until a folder without a lock is a leftover; it gets one right after it was made."""


@contextmanager
def temporary_folder() -> Iterator[str]:
    """Make a folder, and remove it with those that killed processes have left; raises OSError."""
    _sweep(Path(tempfile.gettempdir()))
    with tempfile.TemporaryDirectory(prefix=_PREFIX, ignore_cleanup_errors=True) as name:
        lock = os.open(name, os.O_RDONLY | os.O_DIRECTORY)
        try:
            # The kernel gives it back when this process ends, however it ends.
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield name
        finally:
            os.close(lock)


def _sweep(folder: Path) -> None:
    for path in folder.glob(f"{_PREFIX}*"):
        with suppress(OSError):
            if path.stat().st_uid == os.getuid() and time.time() - path.stat().st_mtime > _AGE:
                _remove(path)


def _remove(path: Path) -> None:
    lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(path)
    finally:
        os.close(lock)
