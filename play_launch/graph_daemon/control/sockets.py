"""Who holds the daemon's port: found in the kernel's tables, without asking anybody."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import psutil

_MODULE: Final = "play_launch.graph_daemon"
_PROGRAM: Final = "play-launch"
_LOOPBACK: Final = "127.0.0.1"
_REACHED_FROM_LOOPBACK: Final = frozenset({_LOOPBACK, "0.0.0.0", "::", f"::ffff:{_LOOPBACK}"})  # noqa: S104 - compared with, not bound to


@dataclass(frozen=True, slots=True)
class Holder:
    """A process that listens on the port.

    ``pid`` is 0 where the process is somebody else's, and the kernel hides which one it is.
    """

    pid: int
    command: tuple[str, ...]

    def __str__(self) -> str:
        if not self.pid:
            return "a process of another user"
        return f"process {self.pid} ({' '.join(self.command)[:120] or 'unknown command'})"

    @property
    def is_daemon(self) -> bool:
        """Whether this is a daemon of the graph, by its command line."""
        return self.is_ours or self.is_ros2_daemon

    @property
    def is_ours(self) -> bool:
        """Whether this is our daemon, in the background or not."""
        in_foreground = self.command[-1:] and {"daemon", "run"} <= set(self.command)
        return _MODULE in self.command or bool(
            in_foreground and any(Path(word).name == _PROGRAM for word in self.command)
        )

    @property
    def is_ros2_daemon(self) -> bool:
        """Whether this is the daemon of ros2cli, by its command line."""
        return any("ros2cli.daemon" in word for word in self.command) or (
            "--name" in self.command and "ros2-daemon" in self.command
        )


def time_wait_ports(port: int) -> list[int]:
    """Return the peers' ports of connections that keep loopback's ``port`` busy though closed."""
    return [
        entry.raddr.port
        for entry in _tcp()
        if entry.status == psutil.CONN_TIME_WAIT
        and (entry.laddr.ip, entry.laddr.port) == (_LOOPBACK, port)
    ]


def holder_of(port: int) -> Holder | None:
    """Return who listens on ``port`` of loopback, or of every address; None when nobody does."""
    pids = [
        entry.pid or 0
        for entry in _tcp()
        if entry.status == psutil.CONN_LISTEN
        and entry.laddr.port == port
        and entry.laddr.ip in _REACHED_FROM_LOOPBACK
    ]
    # While a daemon is being started, its starter has the socket, too; psutil names one of them.
    holders = [holder for pid in pids for holder in (_holder(pid), *_children(pid))]
    return max(holders, key=lambda holder: holder.is_daemon, default=None)


def age_of(pid: int) -> float:
    """Return the seconds since a process began; 0 when it is gone."""
    try:
        return max(0.0, time.time() - psutil.Process(pid).create_time())
    except (psutil.Error, OSError):
        return 0.0


def environment_of(pid: int) -> dict[str, str] | None:
    """Return the variables that a process was started with; None where the kernel hides them."""
    try:
        return psutil.Process(pid).environ()
    except (psutil.Error, OSError):
        return None


def is_stopped(pid: int) -> bool:
    """Whether a process is stopped, by SIGSTOP or a debugger."""
    try:
        status = psutil.Process(pid).status()
    except (psutil.Error, OSError):
        return False
    return status in {psutil.STATUS_STOPPED, psutil.STATUS_TRACING_STOP}


def _tcp() -> list[Any]:
    """List the TCP sockets of this network namespace; none where the kernel hides them."""
    try:
        entries = psutil.net_connections("tcp")
    except (psutil.Error, OSError, RuntimeError):
        return []
    return [entry for entry in entries if entry.laddr]


def _holder(pid: int) -> Holder:
    try:
        return Holder(pid, tuple(psutil.Process(pid).cmdline()) if pid else ())
    except (psutil.Error, OSError):
        return Holder(pid, ())


def _children(pid: int) -> list[Holder]:
    """Return those children of a process which are daemons."""
    try:
        found = [_holder(child.pid) for child in psutil.Process(pid).children()] if pid else []
    except (psutil.Error, OSError):
        return []
    return [holder for holder in found if holder.is_daemon]
