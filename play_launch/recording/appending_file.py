"""A file that grows by whole records only, whatever the disk does."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pathlib import Path

_ROOM: Final = 16 * 1024 * 1024
"""Bytes that have to be free before a file is tried again: with less it would soon fail again."""
_SHARE: Final = 20
"""On a small file system this part of it is enough."""


class AppendingFile:
    """What is appended is held back until :meth:`commit`, which writes all of it or nothing.

    When the disk is full, what was held back stays so, and the file ends after the commit before:
    a later commit goes on as if nothing had been. All methods may raise ``OSError``.

    While it is open the file is locked (``flock``): so others know that it is being written.
    """

    def __init__(self, path: Path) -> None:
        """Create the file; it must not exist."""
        self._descriptor = -1
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._held: list[bytes] = []
        self.size = 0
        """Bytes, those that are held back included."""
        self.committed = 0
        """Bytes that are in the file."""

    @property
    def is_open(self) -> bool:
        """Whether it was not closed yet."""
        return self._descriptor >= 0

    def append(self, data: bytes) -> None:
        """Hold data back for the next commit."""
        self._held.append(data)
        self.size += len(data)

    def append_file(self, descriptor: int, length: int) -> None:
        """Write the beginning of another file, now; nothing may be held back.

        The kernel copies it, while other threads go on.
        """
        at = 0
        try:
            os.lseek(self._descriptor, self.committed, os.SEEK_SET)
            while at < length:
                count = os.sendfile(self._descriptor, descriptor, at, length - at)
                if count == 0:
                    raise OSError(errno.EIO, f"{at} of {length} bytes came")  # noqa: TRY301
                at += count
        except OSError:
            self._end_after_commit()
            raise
        self.committed += length
        self.size += length

    def commit(self) -> None:
        """Write what is held back."""
        if not self._held:
            return
        # Not in the way of many small writes: a chunk and its index go in one piece.
        rest = memoryview(b"".join(self._held))
        at = self.committed
        try:
            while rest:
                count = os.pwrite(self._descriptor, rest, at)
                at += count
                rest = rest[count:]
        except OSError:
            self._end_after_commit()
            raise
        self._held.clear()
        self.committed = at

    def has_room(self) -> bool:
        """Whether the disk has room for what is held back, and for some time after it."""
        system = os.fstatvfs(self._descriptor)
        some_time = min(_ROOM, system.f_blocks * system.f_frsize // _SHARE)
        return system.f_bavail * system.f_frsize >= self.size - self.committed + some_time

    def sync(self) -> None:
        """Force what was committed to the disk; in any thread."""
        try:
            os.fdatasync(self._descriptor)
        except OSError as error:
            if error.errno not in {errno.EINVAL, errno.EROFS}:  # a file that cannot be synced
                raise

    @property
    def is_removed(self) -> bool:
        """Whether it has no name any more: what is written to it is gone when it is closed."""
        return os.fstat(self._descriptor).st_nlink == 0

    def forget_held(self) -> None:
        """Release what is held back."""
        self._held.clear()
        self.size = self.committed
        with contextlib.suppress(OSError):
            self._end_after_commit()

    def close(self) -> None:
        """Close the file and its lock; further calls do nothing."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def _end_after_commit(self) -> None:
        if self._descriptor >= 0:
            os.ftruncate(self._descriptor, self.committed)

    def __del__(self) -> None:
        self.close()


def sync_folder(folder: Path) -> None:
    """Make names in a folder durable, where the file system can."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    except OSError:
        # Some file systems (FUSE, network) refuse this for a folder; the file itself is synced.
        pass
    finally:
        os.close(descriptor)
