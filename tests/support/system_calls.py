"""Programs for which the kernel refuses a system call, as an older one does."""

from __future__ import annotations

import sys
import textwrap
from pathlib import Path

CLOSE_RANGE = 436
"""On every architecture."""
CLOSE_RANGE_CLOEXEC = 4


def refusing(program: Path, folder: Path, call: int, flags: int, error: int) -> Path:
    """Write a program that executes another one whose call with any of the flags fails.

    Args:
        program: The other one.
        folder: Where to write it.
        call: The number of the system call.
        flags: Of its third argument; 0 refuses the call whatever that is.
        error: What it fails with.
    """
    script = f"""\
        #!{sys.executable} -IS
        import ctypes, os, struct, sys
        # Loads the number of the call, compares, loads the flags, compares, answers (seccomp(2)).
        filter = b"".join(struct.pack("=HBBI", *each) for each in [
            (0x20, 0, 0, 0), (0x15, 0, {3 if flags else 1}, {call}),
            *([(0x20, 0, 0, 32), (0x45, 0, 1, {flags})] if {flags} else []),
            (0x06, 0, 0, 0x00050000 | {error}), (0x06, 0, 0, 0x7FFF0000),
        ])
        code = ctypes.create_string_buffer(filter, len(filter))
        program = struct.pack("HP", len(filter) // 8, ctypes.addressof(code))
        libc = ctypes.CDLL(None, use_errno=True)
        assert libc.prctl(38, 1, 0, 0, 0) == 0  # PR_SET_NO_NEW_PRIVS
        assert libc.prctl(22, 2, program, 0, 0) == 0, os.strerror(ctypes.get_errno())  # a filter
        os.execv({str(program)!r}, [{str(program)!r}, *sys.argv[1:]])
    """
    written = folder / f"refusing_{program.name}"
    written.write_text(textwrap.dedent(script))
    written.chmod(0o755)
    return written
