"""What sessions did to groups that outlive them, noted on the groups themselves.

Sessions with the same base come and go in any order, and some are killed: so the last one to end
undoes what others did, too. Where the kernel keeps no such notes (before 5.7), nothing is undone.
"""

from __future__ import annotations

import os
from contextlib import suppress
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pathlib import Path

_MADE: Final = "user.play_launch.made"
_ENABLED: Final = "user.play_launch.enabled"


def note_made(group: Path) -> None:
    """Note that the group was made for us."""
    with suppress(OSError):
        os.setxattr(group, _MADE, b"1")


def is_ours(group: Path) -> bool:
    """Whether it was made for us."""
    with suppress(OSError):
        return _MADE in os.listxattr(group)
    return False


def note_enabled(group: Path, controller: str) -> None:
    """Note that the controller was enabled for us."""
    names = sorted(enabled_for_us(group) | {controller})
    with suppress(OSError):
        os.setxattr(group, _ENABLED, " ".join(names).encode())


def enabled_for_us(group: Path) -> frozenset[str]:
    """Name the controllers that were enabled for us."""
    with suppress(OSError):
        return frozenset(os.getxattr(group, _ENABLED).decode().split())
    return frozenset()


def forget_enabled(group: Path) -> None:
    """Note that none is any more."""
    with suppress(OSError):
        os.removexattr(group, _ENABLED)
