"""File systems of tests: small disks, and mount namespaces of single commands."""

from __future__ import annotations

import contextlib
import ctypes
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

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


@contextlib.contextmanager
def disk_of(size: str, folder: Path) -> Iterator[Path]:
    """Give ``folder``, made for the block, as a disk of that size; skips without the right."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    if subprocess.run(command, check=False, capture_output=True).returncode != 0:
        pytest.skip("mounting needs privileges")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@contextlib.contextmanager
def hung(folder: Path) -> Iterator[Path]:
    """Cover ``folder`` for the block with a mount whose server never answers."""
    folder.mkdir(exist_ok=True)
    try:
        server = os.open("/dev/fuse", os.O_RDWR | os.O_CLOEXEC)
    except OSError as error:
        pytest.skip(f"needs FUSE: {error}")
    libc = ctypes.CDLL(None, use_errno=True)
    options = f"fd={server},rootmode=40000,user_id=0,group_id=0"
    if libc.mount(b"hung", os.fsencode(folder), b"fuse", 0, options.encode()) != 0:
        os.close(server)
        pytest.skip(f"mounting needs privileges: {os.strerror(ctypes.get_errno())}")
    try:
        yield folder
    finally:
        os.close(server)  # what waits for it gets ENOTCONN
        subprocess.run(["umount", "--lazy", str(folder)], check=True)
