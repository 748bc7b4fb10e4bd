"""Puts links where commands look for sessions."""

from __future__ import annotations

from pathlib import Path

from play_launch.control.registration import RegisteredSession
from play_launch.process.identity import read_stat


def put_link(
    links: Path,
    pid: int,
    folder: Path,
    *,
    start_time: int | None = None,
    namespace: int | None = None,
) -> RegisteredSession:
    """Register a session of another process, which has started as it has unless it is said."""
    if start_time is None:
        start_time = read_stat(pid).start_time
    if namespace is None:
        namespace = Path("/proc/self/ns/pid").stat().st_ino
    links.mkdir(mode=0o700, exist_ok=True)
    link = RegisteredSession(pid, str(folder), start_time, namespace)
    (links / link.name).symlink_to(folder)
    return link
