"""What was written for an overlay, so that exactly this can be taken away again."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Final

from play_launch.graph_daemon.patch import PatchError

PACKAGE: Final = "play_launch_ros2cli"
"""The overlay's name as a package; beside it stands the .pth file that starts it."""
STARTER: Final = f"{PACKAGE}.pth"
FILE: Final = "manifest.json"
_FORMAT: Final = 1


@dataclass(frozen=True, slots=True)
class Ros2cli:
    """The ros2cli that the overlay was made for; ``files`` are SHA-256 sums in hexadecimal."""

    folder: str
    version: str
    distribution: str
    files: dict[str, str]


@dataclass(frozen=True, slots=True)
class Manifest:
    """An overlay in a folder.

    Attributes:
        ros2cli: What it changes.
        files: SHA-256 sums of what was written, by path relative to the folder; all but the
            manifest itself.
        made_folders: Folders that were made on the way to it, outermost first.
        written_by: Name and release of the writer.
    """

    ros2cli: Ros2cli
    files: dict[str, str]
    made_folders: tuple[str, ...]
    written_by: str

    def to_json(self) -> bytes:
        """Write it as text."""
        values = {"format": _FORMAT, **asdict(self)}
        return (json.dumps(values, indent=2, ensure_ascii=False) + "\n").encode()

    def edited(self, place: Path) -> list[Path]:
        """Name the files that are no longer as they were written; missing ones do not count."""
        return [
            place / name
            for name, digest in self.files.items()
            if (place / name).exists() and digest_of(place / name) != digest
        ]

    def unknown(self, place: Path) -> list[Path]:
        """Name what lies in the overlay's folder and was not written there by us or by Python."""
        package = place / PACKAGE
        known = {*(place / name for name in self.files), package / FILE}
        return sorted(
            path
            for path in package.rglob("*")
            if path not in known
            and not path.is_dir()
            and not (path.parent.name == "__pycache__" and path.suffix == ".pyc")
        )


def manifest_in(place: Path) -> Manifest | None:
    """Read the manifest of the overlay in ``place``; None when there is no overlay.

    Raises ``PatchError`` when there is something that cannot be understood.
    """
    path = place / PACKAGE / FILE
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        if (place / PACKAGE).exists() or (place / STARTER).exists():
            raise PatchError(
                f"{place / PACKAGE} is there without its {FILE}, so it is not known what belongs "
                f"to it; look at it and remove it and {STARTER} by hand"
            ) from None
        return None
    except OSError as error:
        raise PatchError(f"{path}: {error.strerror or error}") from None
    try:
        values = json.loads(content)
        if values.pop("format") != _FORMAT:
            raise PatchError(f"{path} was written by a newer play-launch; unpatch with that one")
        ros2cli = Ros2cli(**values.pop("ros2cli"))
        made = tuple(map(str, values.pop("made_folders")))
        manifest = Manifest(ros2cli=ros2cli, made_folders=made, **values)
        names = list(manifest.files)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise PatchError(f"{path} is damaged ({error}); remove {path.parent} and {STARTER}") from (
            None
        )
    if outside := [name for name in names if not _is_ours(name)]:
        raise PatchError(f"{path} is damaged: it names {outside[0]!r}")
    return manifest


def digest_of(path: Path) -> str:
    """Give a file's SHA-256 sum; "" when it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


def _is_ours(name: str) -> bool:
    parts = PurePosixPath(name).parts
    return name == STARTER or (len(parts) == 2 and parts[0] == PACKAGE and parts[1] != "..")
