"""Paths in a configuration, and the files beside it: copies of temporary files, long texts."""

from __future__ import annotations

import functools
import os
import re
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Final

import msgspec
from msgspec.structs import replace

from play_launch.config.substitutions import share_folder
from play_launch.launch_files.records import Description

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.launch_files.records import Losses


class Paths:
    """Writes paths, for keys of a configuration and for comments."""

    def __init__(self, folder: Path) -> None:
        self._folder = Path(os.path.abspath(folder))  # noqa: PTH100 - links stay as they are
        self._share = functools.cache(share_folder)

    def value(self, path: str) -> str:
        """Return what stands for an absolute path in a configuration, without escapes.

        A file of an installed package is found wherever that is installed.
        """
        packaged = self._in_package(Path(path))
        if packaged:
            package, below = packaged
            return f"$(find-pkg-share {package})/{below}"
        return self._near(Path(path))

    def shown(self, path: str) -> str:
        """Return the path for a comment: `package/launch/x.launch.xml`."""
        packaged = self._in_package(Path(path))
        return "/".join(packaged) if packaged else self._near(Path(path))

    def _near(self, path: Path) -> str:
        return (
            str(path.relative_to(self._folder)) if path.is_relative_to(self._folder) else str(path)
        )

    def _in_package(self, path: Path) -> tuple[str, str] | None:
        parts = path.parts
        for index in range(len(parts) - 2, 0, -1):
            if parts[index - 1] == "share" and self._share(parts[index]) == Path(
                *parts[: index + 1]
            ):
                return parts[index], str(Path(*parts[index + 1 :]))
        return None


_UNUSUAL: Final = re.compile(r"[^A-Za-z0-9_.-]+", re.ASCII)


class Copies:
    """The files of one configuration; those that hold the same are one."""

    def __init__(self, folder: Path) -> None:
        """Name a folder, in which nothing is written here."""
        self.folder = folder.absolute()
        self.files: dict[Path, bytes] = {}
        self._paths: dict[bytes, str] = {}

    def add(self, name: str, content: bytes) -> str:
        """Take a file, which is called like that or with a number, and return its absolute path."""
        if content in self._paths:
            return self._paths[content]
        plain = Path(_UNUSUAL.sub("_", name).lstrip(".-") or "file")
        number = 1
        while True:
            numbered = plain.stem if number == 1 else f"{plain.stem}_{number}"
            path = self.folder / f"{numbered}{plain.suffix}"
            if path not in self.files:
                break
            number += 1
        self.files[path] = content
        self._paths[content] = str(path)
        return str(path)


_RANDOM: Final = re.compile(r"[a-z0-9_]{8}$", re.ASCII)
"""What `tempfile` makes of a name, which is another one each time."""


def with_copies(description: Description, copies: Copies | None, losses: Losses) -> Description:
    """Name copies in place of temporary files; without copies, what names them is reported."""
    if not description.temporary:
        return description
    if copies is None:
        for unit in description.units:
            text = str(msgspec.to_builtins(unit))
            for each in description.temporary:
                if each.path in text:
                    what = f"it names a temporary file, which does not stay: {each.path}"
                    losses.lost(unit.described, what)
        return description
    names = {
        each.path: copies.add(_name(each.path), each.content) for each in description.temporary
    }
    # Of two paths of which one begins with the other, the longer one first.
    ordered = dict(sorted(names.items(), key=lambda pair: -len(pair[0])))
    values = msgspec.to_builtins(replace(description, temporary=[]), builtin_types=(bytes,))
    return msgspec.convert(_replaced(values, ordered), Description)


def _name(path: str) -> str:
    stem, dot, ending = PurePath(path).name.partition(".")
    return f"{_RANDOM.sub('', stem).strip('_-') or 'file'}{dot}{ending}"


def _replaced(value: Any, names: Mapping[str, str]) -> Any:
    if isinstance(value, str):
        for before, after in names.items():
            value = value.replace(before, after)
        return value
    if isinstance(value, dict):
        return {key: _replaced(each, names) for key, each in value.items()}
    if isinstance(value, list):
        return [_replaced(each, names) for each in value]
    return value
