"""Paths as people read them: by package, or from the folder of the configuration."""

from __future__ import annotations

import os
from pathlib import Path

from play_launch.config.substitutions import share_folder


class Paths:
    """Writes paths, for keys of a configuration and for comments."""

    def __init__(self, folder: Path) -> None:
        self._folder = Path(os.path.abspath(folder))  # noqa: PTH100 - links stay as they are
        self._shares: dict[str, Path | None] = {}

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

    def _share(self, package: str) -> Path | None:
        if package not in self._shares:
            self._shares[package] = share_folder(package)
        return self._shares[package]
