"""Groups of sessions whose supervisor is the test."""

from __future__ import annotations

import os
from pathlib import Path

from play_launch.config.resources import GroupPolicy
from play_launch.process.cgroups.names import SessionName
from play_launch.process.cgroups.session import SessionGroups
from play_launch.process.identity import ProcessIdentity, read_stat


def lives(pid: int, start_time: int) -> bool:
    return ProcessIdentity(pid, start_time).is_alive()


def session_groups() -> SessionGroups:
    """Those of a session whose supervisor is this process."""
    namespace = Path("/proc/self/ns/pid").stat().st_ino
    return SessionGroups(
        SessionName(namespace, os.getpid(), read_stat(os.getpid()).start_time), lives
    )


def begun(base: Path, **policy: bool) -> SessionGroups:
    groups = session_groups()
    groups.begin(GroupPolicy(enabled=True, base_path=base, **policy), ())
    assert groups.folder is not None
    return groups


def below(base: Path) -> list[str]:
    return sorted(each.name for each in base.iterdir() if each.is_dir())
