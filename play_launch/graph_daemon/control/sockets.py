"""Who holds the daemon's port: read from the kernel's tables, without asking anybody."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

_PROC: Final = Path("/proc")
_MODULE: Final = "play_launch.graph_daemon"
_PROGRAM: Final = "play-launch"
_START_TIME: Final = 19
"""Field 22 of proc_pid_stat(5), counted behind the program's name: clock ticks after boot."""
_LISTENING: Final = "0A"
_TIME_WAIT: Final = "06"
_ANYWHERE: Final = "00000000"
_LOOPBACK: Final = "0100007F"
"""127.0.0.1, as a little-endian kernel writes it."""


@dataclass(frozen=True, slots=True)
class TcpEntry:
    """A line of ``/proc/net/tcp``; addresses are its hexadecimal digits."""

    address: str
    port: int
    peer_port: int
    state: str
    inode: int


@dataclass(frozen=True, slots=True)
class Holder:
    """A process that listens on the port.

    ``pid`` is 0 where the process is somebody else's, so that nobody tells which one it is.
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


def parse_tcp(table: str) -> list[TcpEntry]:
    """Read a table like ``/proc/net/tcp`` or ``tcp6``; lines that are none are left out."""
    entries = []
    for line in table.splitlines():
        fields = line.split()
        try:
            address, _, port = fields[1].rpartition(":")
            peer_port = fields[2].rpartition(":")[2]
            entry = TcpEntry(
                address, int(port, 16), int(peer_port, 16), fields[3].upper(), int(fields[9])
            )
        except (IndexError, ValueError):
            continue
        entries.append(entry)
    return entries


def time_wait_ports(entries: list[TcpEntry], port: int) -> list[int]:
    """Return the peers' ports of connections that keep loopback's ``port`` busy though closed."""
    return [
        entry.peer_port
        for entry in entries
        if entry.port == port and entry.state == _TIME_WAIT and entry.address == _LOOPBACK
    ]


def listening_inodes(entries: list[TcpEntry], port: int) -> set[int]:
    """Return the inodes of sockets that listen on ``port`` of loopback, or of every address."""
    return {
        entry.inode
        for entry in entries
        if entry.port == port
        and entry.state == _LISTENING
        and (entry.address == _LOOPBACK or set(entry.address) == set(_ANYWHERE))
    }


def read_tcp() -> list[TcpEntry]:
    """Read the tables of this network namespace."""
    entries = []
    for name in ("tcp", "tcp6"):
        try:
            entries += parse_tcp((_PROC / "net" / name).read_text(encoding="ascii"))
        except (OSError, UnicodeDecodeError):
            continue
    return entries


def holder_of(port: int) -> Holder | None:
    """Return who listens on ``port`` of loopback; None when nobody does."""
    inodes = listening_inodes(read_tcp(), port)
    if not inodes:
        return None
    wanted = {f"socket:[{inode}]" for inode in inodes}
    holders = [
        Holder(int(process.name), _command(process))
        for process in _PROC.iterdir()
        if process.name.isdigit() and _has_one_of(process, wanted)
    ]
    # While a daemon is being started, its starter has the socket, too.
    return max(holders, key=lambda holder: holder.is_daemon, default=Holder(0, ()))


def age_of(pid: int) -> float:
    """Return the seconds since a process began; 0 when it is gone."""
    try:
        # The name of the program, in parentheses, may hold anything.
        fields = (_PROC / str(pid) / "stat").read_text(errors="replace").rpartition(")")[2].split()
        uptime = float((_PROC / "uptime").read_text(encoding="ascii").split()[0])
        return max(0.0, uptime - int(fields[_START_TIME]) / os.sysconf("SC_CLK_TCK"))
    except (OSError, IndexError, ValueError):
        return 0.0


def _has_one_of(process: Path, links: set[str]) -> bool:
    try:
        files = list((process / "fd").iterdir())
    except OSError:
        return False
    for file in files:
        try:
            if os.readlink(file) in links:  # noqa: PTH115 - a socket is no path
                return True
        except OSError:
            continue
    return False


def _command(process: Path) -> tuple[str, ...]:
    try:
        words = (process / "cmdline").read_bytes().split(b"\0")
    except OSError:
        return ()
    return tuple(word.decode("utf-8", "replace") for word in words if word)
