"""Finds and reads launch files, by a path or by a package and a name."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.config.source import Refused, read_bytes
from play_launch.config.substitutions import not_installed, share_folder
from play_launch.launch_files.records import LaunchFileError

if TYPE_CHECKING:
    from collections.abc import Iterator

LARGEST: Final = 16 * 2**20
"""Bytes of a launch file, of a parameter file, and of what else is read."""


_LAUNCH_KEY: Final = re.compile(rb"^(?:\xef\xbb\xbf)?([\"']?)launch\1\s*:", re.MULTILINE)
ENDINGS: Final = (".py", ".xml", ".yaml", ".yml", ".launch")


def find(words: list[str]) -> Path:
    """Return the launch file for one word, a path, or two, a package and the name of a file.

    Raises:
        LaunchFileError: When there is no such file, or more than one.
    """
    if len(words) == 1:
        path = Path(words[0]).expanduser()
        if path.is_file():
            return path
        hint = "; give PACKAGE FILE, or a path" if path.parent == Path() else ""
        raise LaunchFileError(f"{path}: {_why_not(path)}{hint}")
    package, name = words
    share = share_folder(package)
    if share is None:
        raise LaunchFileError(not_installed(package))
    found = sorted(_named(share, name))
    if not found:
        raise LaunchFileError(f"{package} has no launch file {name}{_others(share)}")
    if len(found) > 1:
        several = ", ".join(map(str, found))
        raise LaunchFileError(f"{package} has several files {name}: {several}; give a path")
    return found[0]


def _why_not(path: Path) -> str:
    if not path.exists():
        return "there is no such launch file"
    content = read_bytes(path)
    return content.message if isinstance(content, Refused) else "is no regular file"


def is_launch_file(path: Path) -> bool:
    """Return whether it is a launch file, not a configuration, which may be YAML as well."""
    if path.suffix not in {".yaml", ".yml"}:
        return path.name.endswith(ENDINGS)
    content = read_bytes(path, LARGEST)
    return not isinstance(content, Refused) and _LAUNCH_KEY.search(content) is not None


def _named(share: Path, name: str) -> Iterator[Path]:
    for folder, _, files in os.walk(share, followlinks=True):
        if name in files:
            yield Path(folder) / name


def launch_files(share: Path) -> list[str]:
    """Return the names of what look like launch files in a package."""
    return sorted(
        {
            name
            for folder, _, files in os.walk(share, followlinks=True)
            for name in files
            if name.endswith(ENDINGS) and ("launch" in name or Path(folder).name == "launch")
        }
    )


def _others(share: Path) -> str:
    names = launch_files(share)
    return f"; it has {', '.join(names[:10])}" if names else " at all"
