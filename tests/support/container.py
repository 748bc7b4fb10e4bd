"""The real container, started without a supervisor."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from play_launch.container.environment import child_environment
from play_launch.container.ros import component_container, ros_installation


@contextmanager
def running_container(
    *arguments: str,
    name: str = "container",
    log: Path | None = None,
    environment: Mapping[str, str] | None = None,
    pass_fds: tuple[int, ...] = (),
) -> Iterator[subprocess.Popen[bytes]]:
    """Start ``component_container`` as ``/name``; afterwards stop it by SIGTERM and reap it."""
    command = [
        str(component_container()),
        *arguments,
        "--ros-args",
        "-r",
        f"__node:={name}",
    ]
    with (log or Path(os.devnull)).open("wb") as output:
        process = subprocess.Popen(
            command,
            env={**child_environment(os.environ, ros_installation()), **(environment or {})},
            stdout=output,
            stderr=subprocess.STDOUT,
            pass_fds=pass_fds,
        )
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
            try:
                process.wait(timeout=60)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                raise
