"""Files that stand beside a configuration: copies of temporary files, and long texts."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

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
