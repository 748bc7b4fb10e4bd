"""Message definitions for the bag, taken from the installed ``.msg`` files.

A reader of a bag has no ROS installation to ask, so a schema carries the definition of its type
followed by those of all types it uses, each under a line of 80 ``=`` and ``MSG: package/Name``.
That is the encoding ``ros2msg`` of the MCAP registry, the one rosbag2 writes as well.
"""

from __future__ import annotations

import os
import re
import sys
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.recording.errors import SchemaNotFoundError

if TYPE_CHECKING:
    from collections.abc import Mapping

_SEPARATOR: Final = "=" * 80
_PRIMITIVES: Final = frozenset(
    {"bool", "byte", "char", "float32", "float64", "string", "wstring"}
    | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)
_FIELD: Final = re.compile(
    r"^\s*(?P<type>[A-Za-z][A-Za-z0-9_/]*)"  # a comment begins with #, so it does not match
    r"(?:<=\d+)?(?:\[[^\]]*\])?"  # bound of a string, then array
    r"\s+[A-Za-z]"  # the field's name
)


def search_prefixes(environ: Mapping[str, str] = os.environ) -> tuple[Path, ...]:
    """Prefixes that may hold message packages: the ament overlays, then Python's own prefix.

    ROS from wheels installs into the latter and needs no ``AMENT_PREFIX_PATH``.
    """
    overlays = [Path(entry) for entry in environ.get("AMENT_PREFIX_PATH", "").split(":") if entry]
    return tuple(dict.fromkeys([*overlays, Path(sys.prefix)]))


def message_definition(type_name: str, prefixes: tuple[Path, ...] | None = None) -> str:
    """Return the definition of ``package/msg/Name`` with everything it depends on.

    Raises :class:`SchemaNotFoundError` when a definition is not installed below ``prefixes``.
    """
    places = search_prefixes() if prefixes is None else prefixes
    package, name = _split(type_name, "")
    seen = {(package, name)}
    waiting = deque(seen)
    parts: list[str] = []
    while waiting:
        package, name = waiting.popleft()
        text = _read(package, name, places)
        parts.append(text if not parts else f"{_SEPARATOR}\nMSG: {package}/{name}\n{text}")
        for used in _used_types(text, package):
            if used not in seen:
                seen.add(used)
                waiting.append(used)
    return "".join(part if part.endswith("\n") else part + "\n" for part in parts)


def _used_types(text: str, package: str) -> list[tuple[str, str]]:
    used: list[tuple[str, str]] = []
    for line in text.splitlines():
        match = _FIELD.match(line)
        if match and match["type"] not in _PRIMITIVES:
            used.append(_split(match["type"], package))
    return used


def _split(type_name: str, package: str) -> tuple[str, str]:
    """``package/msg/Name``, ``package/Name`` or ``Name`` in ``package`` -> (package, name)."""
    if type_name == "Header":
        return "std_msgs", "Header"
    first, _, _ = type_name.partition("/")
    return (package if first == type_name else first), type_name.rpartition("/")[2]


def _read(package: str, name: str, prefixes: tuple[Path, ...]) -> str:
    for prefix in prefixes:
        try:
            return (prefix / "share" / package / "msg" / f"{name}.msg").read_text(encoding="utf-8")
        except (FileNotFoundError, NotADirectoryError):
            continue
    raise SchemaNotFoundError(f"{package}/msg/{name}", prefixes)
