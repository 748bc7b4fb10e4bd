"""Whether a program can be started, and why not."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


class SpawnError(Exception):
    """A program could not be started.

    Attributes:
        argv: The command line.
        errno: The error number, 0 where the arguments themselves are unusable.
    """

    def __init__(self, argv: Sequence[str], reason: str, errno: int = 0) -> None:
        program = argv[0] if argv else "a program without a name"
        super().__init__(f"cannot start {program}: {reason}")
        self.argv = tuple(argv)
        self.errno = errno

    @classmethod
    def of(cls, argv: Sequence[str], error: OSError) -> SpawnError:
        """Put an error of the system into words."""
        reason = error.strerror or str(error)
        named = error.filename
        if named is not None and str(named) != argv[0]:
            reason = f"{reason}: {named}"
        return cls(argv, reason, error.errno or 0)


def check_program(argv: Sequence[str], env: Mapping[str, str], cwd: Path | None) -> None:
    """Check the program before the guard runs, whose own message would be output.

    Raises:
        SpawnError: When there is no such program or folder, or it cannot be executed.
    """
    if not argv or not argv[0]:
        raise SpawnError(argv, "the command line is empty")
    if cwd is not None and not cwd.is_dir():
        reason = FileNotFoundError(2, f"its working directory is no directory: {cwd}")
        raise SpawnError.of(argv, reason)
    program = argv[0]
    if "/" in program:
        path = Path(cwd or ".") / program
        if not path.exists():
            raise SpawnError.of(argv, FileNotFoundError(2, "no such file"))
        if path.is_dir() or not os.access(path, os.X_OK):
            raise SpawnError.of(argv, PermissionError(13, "it is not an executable file"))
    elif shutil.which(program, path=env.get("PATH", os.defpath)) is None:
        raise SpawnError.of(argv, FileNotFoundError(2, "no such program in PATH"))
