"""Commands in a mount namespace of their own, in which other file systems are mounted."""

from __future__ import annotations

import subprocess

import pytest

NO_PROC = "mount -t tmpfs tmpfs /proc"


def small_shared_memory(size: str) -> str:
    return f"mount -t tmpfs -o size={size} tmpfs /dev/shm"


def mounted(mount: str, *command: object) -> list[str]:
    """Return the command line that runs a command after ``mount``; skips where that is denied."""
    own = ["unshare", "--mount", "sh", "-c", f'{mount} && exec "$@"', "sh"]
    denied = subprocess.run([*own, "true"], capture_output=True, text=True, check=False)
    if denied.returncode != 0:
        pytest.skip(f"needs a mount namespace ({mount}): {denied.stderr.strip()}")
    return [*own, *map(str, command)]
