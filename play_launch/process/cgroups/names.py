"""What control groups are called. Pure."""

from __future__ import annotations

import hashlib
import re
from typing import Final

from msgspec import Struct

SUPERVISOR: Final = "play-launch-supervisor"
CONTAINER: Final = "container"
_SESSION: Final = re.compile(r"play-launch-([0-9]+)-([0-9]+)-([0-9]+)", re.ASCII)
_LONGEST: Final = 200
"""Bytes; names of folders have 255, and an attempt is to follow."""
_DIGEST: Final = 16


class SessionName(Struct, frozen=True):
    """Whose session it is: the PID namespace, by its inode, and in it pid and start time."""

    namespace: int
    pid: int
    start_time: int
    """Clock ticks after boot."""

    def __str__(self) -> str:
        return f"play-launch-{self.namespace}-{self.pid}-{self.start_time}"

    @classmethod
    def parsed(cls, name: str) -> SessionName | None:
        """Read what `str` wrote; None when it is no such name."""
        found = _SESSION.fullmatch(name)
        return cls(*map(int, found.groups())) if found else None


def group_name(full_name: str) -> str:
    """Name the group of a member by its full name: no two have the same.

    ROS's names have neither colons nor dots, so no name is that of a file of the kernel.
    """
    name = re.sub(r"[^A-Za-z0-9_~:\[\]-]", _escaped, full_name.lstrip("/").replace("/", ":"))
    if len(name) <= _LONGEST:
        return name or "_"
    digest = hashlib.blake2b(name.encode(), digest_size=_DIGEST // 2).hexdigest()
    return f"{name[: _LONGEST - _DIGEST - 1]}+{digest}"


def node_group_name(full_name: str, attempt: int) -> str:
    """Name the group of a node: two loads never share one."""
    return f"{group_name(full_name)}.{attempt}"


def _escaped(found: re.Match[str]) -> str:
    return "".join(f"%{byte:02x}" for byte in found[0].encode("utf-8", "surrogateescape"))
