"""The folder of a session: ``<log folder>/<time>-<name>/``, with ``latest`` pointing to it."""

from __future__ import annotations

import logging
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.recording.errors import SessionFolderError, reason

if TYPE_CHECKING:
    from collections.abc import Mapping
    from datetime import datetime

BAG_NAME: Final = "session.mcap"
LATEST: Final = "latest"

_log = logging.getLogger(__name__)
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9._-]+")
_LONGEST_NAME: Final = 100


@dataclass(frozen=True, slots=True)
class SessionFolder:
    """Where one session keeps what it writes."""

    path: Path

    @property
    def bag(self) -> Path:
        """The recording's final name; while it is written, ``.active`` is appended."""
        return self.path / BAG_NAME


def default_log_folder(environ: Mapping[str, str] = os.environ) -> Path:
    """Where sessions go when nobody says otherwise.

    ``$PLAY_LAUNCH_LOG_DIR``, else ``$ROS_LOG_DIR/play_launch``, else ``~/.ros/play_launch``.
    """
    if own := environ.get("PLAY_LAUNCH_LOG_DIR"):
        return Path(own).expanduser()
    if ros := environ.get("ROS_LOG_DIR"):
        return Path(ros).expanduser() / "play_launch"
    return Path("~/.ros/play_launch").expanduser()


def create_session_folder(log_folder: Path, name: str, now: datetime) -> SessionFolder:
    """Make a new folder for the session and point ``latest`` to it.

    A second session of the same name in the same second gets ``-2`` appended, and so on.
    ``latest`` is relative, so that the log folder can be moved. Raises
    :class:`SessionFolderError`.
    """
    stem = f"{now:%Y-%m-%d-%H-%M-%S}-{_file_name(name)}"
    try:
        log_folder.mkdir(parents=True, exist_ok=True)
        folder = _make_unique(log_folder, stem)
    except OSError as error:
        raise SessionFolderError(log_folder / stem, error) from error
    try:
        _point(log_folder / LATEST, folder.name)
    except OSError as error:
        # A file system without symbolic links, or somebody's own file of that name: the session
        # itself does not depend on it.
        _log.warning("cannot point %s to %s: %s", log_folder / LATEST, folder.name, reason(error))
    return SessionFolder(folder)


def _make_unique(log_folder: Path, stem: str) -> Path:
    number = 1
    while True:
        folder = log_folder / (stem if number == 1 else f"{stem}-{number}")
        try:
            folder.mkdir()
        except FileExistsError:
            number += 1
        else:
            return folder


def _point(link: Path, target: str) -> None:
    # Renaming replaces in one step: a reader finds the old session or the new one, never nothing.
    temporary = link.with_name(f".{link.name}-{target}")
    temporary.symlink_to(target)
    try:
        temporary.replace(link)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def _file_name(name: str) -> str:
    return _UNSAFE.sub("_", name).strip("._")[:_LONGEST_NAME] or "session"
