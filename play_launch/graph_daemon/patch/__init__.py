"""A patch for an installed ros2cli's own daemon, which changes none of ros2cli's files.

The folder ``overlay`` and a ``.pth`` file that starts it are copied into a folder of packages, and
removed again. Nothing of ros2cli's source is here or in what is written.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch import UserError

if TYPE_CHECKING:
    from collections.abc import Mapping

PACKAGE: Final = "play_launch_ros2cli"
STARTER: Final = f"{PACKAGE}.pth"
_SOURCE: Final = Path(__file__).with_name("overlay")
# In one line, as Python wants it; silent when the package has been removed without this file.
_START: Final = (
    f'import sys; exec("try:\\n    import {PACKAGE} as o; o.install()\\n'
    'except ImportError:\\n    pass")\n'
)


class PatchError(UserError):
    """The patch was not written or not removed; the text names the fix."""


def default_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Return the folder of packages that the Python of the command ``ros2`` reads.

    Beside ros2cli in a virtual environment; for a sourced ROS, whose folder Python does not search
    for ``.pth`` files, the user's own. Raises ``PatchError`` when there is no ros2cli.
    """
    program = shutil.which("ros2", path=environment.get("PATH", os.defpath))
    roots = [Path(entry) for entry in environment.get("PYTHONPATH", "").split(os.pathsep) if entry]
    prefix = Path(program).absolute().parent.parent if program else None
    if prefix is not None:
        roots += sorted(prefix.glob("lib/python3*/*-packages"))
    sites = [root for root in roots if (root / "ros2cli").is_dir()]
    if not sites:
        raise PatchError("ros2cli: not found; source your ROS 2 first, or use --into FOLDER")
    site = sites[0]
    if prefix is not None and (prefix / "pyvenv.cfg").exists() and site.is_relative_to(prefix):
        return site
    # .../lib/python3.12/site-packages
    return Path.home() / ".local" / "lib" / site.parent.name / "site-packages"


def write(folder: Path) -> None:
    """Copy the overlay into ``folder``, in place of an older one; raises ``PatchError``."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(folder / PACKAGE, ignore_errors=True)
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(_SOURCE, folder / PACKAGE, ignore=ignored)
        (folder / STARTER).write_text(_START, encoding="utf-8")
    except OSError as error:
        raise _failed(folder, error) from None


def remove(folder: Path) -> bool:
    """Remove the overlay from ``folder``; False if it is not there. Raises ``PatchError``."""
    present = is_written(folder)
    try:
        (folder / STARTER).unlink(missing_ok=True)
        with contextlib.suppress(FileNotFoundError):
            shutil.rmtree(folder / PACKAGE)
    except OSError as error:
        raise _failed(folder, error) from None
    return present


def is_written(folder: Path) -> bool:
    """Whether the overlay, or a part of it, is in ``folder``."""
    return (folder / STARTER).exists() or (folder / PACKAGE).exists()


def _failed(folder: Path, error: OSError) -> PatchError:
    return PatchError(
        f"{folder}: {error.strerror or error}; run the command as a user with write permission, "
        "or use --into FOLDER"
    )
