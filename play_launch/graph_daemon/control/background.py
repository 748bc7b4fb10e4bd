"""Starts a daemon in the background and waits until it serves."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import sys
import time
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final

from play_launch.process.machine import (
    SHARED_MEMORY_FIX,
    full_shared_memory,
    shared_memory_room,
)
from play_launch.ros.fastdds.profiles import PROFILE_FILES

if TYPE_CHECKING:
    import socket
    from collections.abc import Mapping

    from play_launch.graph_daemon.contract import DaemonAddress

START_LIMIT: Final = 60.0
"""Seconds until a daemon must serve; on a machine under full load loading ROS takes some."""
_LAST_WORDS: Final = 3.0
_LINES_OF_LOG: Final = 5


class StartError(Exception):
    """The daemon could not be started; the text says why, for a person."""


def log_path(address: DaemonAddress, environment: Mapping[str, str] = os.environ) -> Path:
    """Return where a daemon in the background logs; that of its last run is overwritten."""
    folder = environment.get("ROS_LOG_DIR") or Path.home() / ".ros" / "log"
    return Path(folder) / f"play_launch_daemon_{address.domain}.log"


def spawn(
    address: DaemonAddress,
    listener: socket.socket,
    *,
    idle_timeout: float,
    wait_for: str,
    limit: float = START_LIMIT,
    environment: Mapping[str, str] = os.environ,
) -> subprocess.Popen[bytes]:
    """Start a daemon on ``listener`` and return its process, which the caller is to wait for.

    Args:
        address: Where it serves.
        listener: Listens there; the daemon has it afterwards, here it can be closed.
        idle_timeout: Seconds without a request after which it ends; 0 for never.
        wait_for: What it must report before this returns: `LISTENING` or `WARM`.
        limit: Seconds that this may take.
        environment: For the daemon's process.

    Raises ``StartError`` when it does not come so far; it does not run then.
    """
    if full := full_shared_memory(shared_memory_room()):
        raise StartError(f"{full}; fix: {SHARED_MEMORY_FIX}")
    read, write = os.pipe()
    log = _log_file(log_path(address, environment))
    try:
        with open(os.devnull, "rb") as nothing:  # noqa: PTH123
            process = subprocess.Popen(
                [
                    sys.executable,
                    # The working directory is no place for modules.
                    "-P",
                    "-m",
                    "play_launch.graph_daemon",
                    f"--domain={address.domain}",
                    f"--listener={listener.fileno()}",
                    f"--ready={write}",
                    f"--idle-timeout={idle_timeout:g}",
                ],
                stdin=nothing,
                stdout=log,
                stderr=log,
                pass_fds=(listener.fileno(), write),
                env=dict(environment),
                cwd=_working_directory(),
                start_new_session=True,
            )
    except OSError as error:
        os.close(read)
        log.close()
        raise StartError(f"the daemon could not be started: {error}") from None
    finally:
        os.close(write)
    with log:
        try:
            reported = _wait(read, wait_for, limit)
        finally:
            os.close(read)
        if not reported:
            # It may be writing why.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_LAST_WORDS)
            process.kill()
            process.wait()
            raise StartError(f"the daemon ended or got stuck while it started{_end_of(log)}")
    return process


def _wait(read: int, word: str, limit: float) -> bool:
    deadline = time.monotonic() + limit
    received = b""
    while True:
        left = deadline - time.monotonic()
        if left <= 0 or not select.select([read], [], [], left)[0]:
            return False
        more = os.read(read, 1024)
        received += more
        if word.encode("ascii") in received.split():
            return True
        if not more:
            return False


def _working_directory() -> str | None:
    """Stay where a profile of Fast DDS is; elsewhere do not hold the folder."""
    here = any(Path(name).exists() for name in PROFILE_FILES)
    return None if here else "/"


def _log_file(path: Path) -> IO[bytes]:
    """Open a new file; in a shared folder, another user may have put a link or pipe there."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        return path.open("x+b")
    except OSError:
        # Not worth to do without the daemon.
        return open(os.devnull, "r+b")  # noqa: PTH123


def _end_of(log: IO[bytes]) -> str:
    try:
        log.seek(0)
        lines = log.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return ""
    if not lines:
        return ""
    return "\n".join([f"; see {log.name}", *(f"  {line}" for line in lines[-_LINES_OF_LOG:])])
