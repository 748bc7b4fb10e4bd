"""What can go wrong with a recording; each message has the fix."""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING

from play_launch import UserError

if TYPE_CHECKING:
    from pathlib import Path


class RecordingError(UserError):
    """The recording cannot be started or cannot go on."""


class WriteFailedError(RecordingError):
    """The file took no more data; ``path`` holds everything up to the last complete chunk."""

    def __init__(self, path: Path, cause: OSError) -> None:
        """``path`` is the file that was being written, ``cause`` the system's answer."""
        super().__init__(f"cannot write {path}: {reason(cause)}; {_fix(cause)}")
        self.path = path


class SchemaNotFoundError(RecordingError):
    """The definition of a message type is not installed, or no reader would take its name."""


def reason(cause: OSError) -> str:
    """The system's words for an error, without Python's decoration."""
    return cause.strerror or str(cause)


def _fix(cause: OSError) -> str:
    if cause.errno in (errno.ENOSPC, errno.EDQUOT):
        return "free some space, or choose another place with --log-dir DIR"
    if cause.errno == errno.EFBIG:
        return "set record.rotate.size to less than the limit (ulimit -f)"
    if cause.errno == errno.ENOENT:  # it was opened before
        return "it, or its folder, was removed; the next start records again"
    return "choose another place with --log-dir DIR"
