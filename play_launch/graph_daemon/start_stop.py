"""Starts the daemon of a domain in the background and waits until it serves."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final

from play_launch import UserError
from play_launch.container.ros import log_folder
from play_launch.graph_daemon.contract import IDLE_TIMEOUT, WARM
from play_launch.graph_daemon.port import acquire
from play_launch.process.preflight import (
    full_shared_memory,
)
from play_launch.ros.fastdds.middleware import PROFILE_FILES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from play_launch.graph_daemon.contract import DaemonAddress

START_LIMIT: Final = 60.0
"""Seconds until a daemon must serve; on a machine under full load loading ROS takes some."""
_EXIT_TIMEOUT: Final = 3.0
_LINES_OF_LOG: Final = 5


class DaemonStartError(UserError):
    """The daemon could not be started; the text is a message for the user."""

    exit_code = 1


@dataclass(frozen=True, slots=True)
class StartedDaemon:
    """Result of a start."""

    started: bool
    """False when a daemon of ours ran already."""
    pid: int
    messages: tuple[str, ...]
    """Lines for the user: the daemon that was replaced, settings that differ."""
    process: subprocess.Popen[bytes] | None = None
    """The process that was started; a caller that lives longer than it must wait for it."""


def start_daemon(
    address: DaemonAddress,
    *,
    idle_timeout: float = IDLE_TIMEOUT,
    wait_for: str = WARM,
    restart: bool = False,
    environment: Mapping[str, str] = os.environ,
    notify: Callable[[str], None] = lambda _: None,
) -> StartedDaemon:
    """Start a daemon in the background, unless one of ours runs.

    It ends after ``idle_timeout`` seconds without a request; 0 is never. ``wait_for`` is
    `LISTENING` or `WARM`. The other arguments are as of `acquire`; the environment is that of the
    daemon's process. Raises ``PortHeldError``, ``DaemonStartError`` and ``DaemonError``.
    """
    port = acquire(address, restart=restart, environment=environment, notify=notify)
    if port.listener is None:
        return StartedDaemon(started=False, pid=port.pid, messages=port.messages)
    with port.listener as listener:
        if full := full_shared_memory():
            raise DaemonStartError(full)
        read, write = os.pipe()
        log = _log_file(log_path(address, environment))
        try:
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
                stdin=subprocess.DEVNULL,
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
            raise DaemonStartError(f"the daemon could not be started: {error}") from None
        finally:
            os.close(write)
        with log:
            try:
                reported = _wait(read, wait_for)
            finally:
                os.close(read)
            if not reported:
                # It may be writing the reason.
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(_EXIT_TIMEOUT)
                process.kill()
                process.wait()
                raise DaemonStartError(f"the daemon ended or hung while it started{_end_of(log)}")
    return StartedDaemon(started=True, pid=process.pid, messages=port.messages, process=process)


def log_path(address: DaemonAddress, environment: Mapping[str, str] = os.environ) -> Path:
    """Return the log file of a daemon in the background; the last run's is overwritten."""
    folder = log_folder(environment) or Path("~/.ros/log").expanduser()
    return folder / f"play_launch_daemon_{address.domain}.log"


def _wait(read: int, word: str) -> bool:
    deadline = time.monotonic() + START_LIMIT
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
    """Keep a working directory with a profile of Fast DDS; do not block any other."""
    here = any(Path(name).exists() for name in PROFILE_FILES)
    return None if here else "/"


def _log_file(path: Path) -> IO[bytes]:
    """Open a new file; in a shared folder, another user may have put a link or pipe there."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        return path.open("x+b")
    except OSError:
        # The daemon is worth more than its log.
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
