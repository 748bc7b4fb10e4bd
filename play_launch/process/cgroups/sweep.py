"""Removes the groups of sessions whose supervisor has died, with what still runs in them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.process.cgroups.group import Group
from play_launch.process.cgroups.names import SessionName

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

_LIMIT: Final = 5.0
"""Seconds from the kill to the end of processes; uninterruptible ones stay, with their group."""


def dead_sessions(
    names: Iterable[str], namespace: int, lives: Callable[[int, int], bool]
) -> Iterator[str]:
    """Choose those whose supervisor is dead; of other PID namespaces nothing is known.

    Args:
        names: Names of folders.
        namespace: Our own PID namespace.
        lives: Whether the process of that pid and start time lives.
    """
    for name in names:
        session = SessionName.parsed(name)
        if session is None or session.namespace != namespace:
            continue
        if not lives(session.pid, session.start_time):
            yield name


def sweep(base: Path, namespace: int, lives: Callable[[int, int], bool]) -> tuple[str, ...]:
    """Remove those below a base, and name what was removed."""
    try:
        names = [each.name for each in base.iterdir() if each.is_dir()]
    except OSError:
        return ()
    dead = dead_sessions(names, namespace, lives)
    return tuple(name for name in dead if Group(base / name).clear(_LIMIT))
