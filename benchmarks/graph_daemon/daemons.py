"""The two daemons, started and stopped by the commands that people use."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import psutil

from play_launch.graph_daemon.contract import daemon_address
from play_launch.graph_daemon.port import acquire

_LIMIT = 60.0
_ROS2 = "import sys; sys.argv[0] = 'ros2'; from ros2cli.cli import main; sys.exit(main())"


def ros2cli_is_here() -> bool:
    """Whether ros2cli can be imported, by PYTHONPATH or installed."""
    return all(importlib.util.find_spec(name) for name in ("ros2cli", "ros2node"))


@dataclass(frozen=True)
class Daemon:
    """A daemon by its commands."""

    name: str
    command: tuple[str, ...]

    def run(self, *arguments: str, limit: float = _LIMIT) -> tuple[float, str]:
        """Run a command; returns the seconds that it took and what it printed."""
        began = time.monotonic()
        done = subprocess.run(
            [*self.command, *arguments],
            check=False,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=limit,
        )
        return time.monotonic() - began, done.stdout

    def start(self) -> float:
        # Closed connections of the measurement before may keep the port for a minute.
        listener = acquire(daemon_address()).listener
        assert listener is not None, "a daemon runs already"
        listener.close()
        seconds, text = self.run("daemon", "start")
        if "started" not in text:
            raise SystemExit(f"{self.name} was not started: {text}")
        return seconds

    def stop(self) -> float:
        try:
            return self.run("daemon", "stop")[0]
        except subprocess.TimeoutExpired:
            # It hangs.
            for pid in _listeners(daemon_address().port):
                os.kill(pid, signal.SIGKILL)
            return _LIMIT


def _listeners(port: int) -> set[int]:
    return {
        connection.pid
        for connection in psutil.net_connections("tcp")
        if connection.pid
        and connection.status == psutil.CONN_LISTEN
        and connection.laddr[1:] == (port,)
    }


OURS = Daemon("play-launch", (str(Path(sys.executable).parent / "play-launch"),))
STOCK = Daemon("ros2cli", (sys.executable, "-W", "ignore", "-c", _ROS2))
