"""Whether the middleware that RMW_IMPLEMENTATION asks for can be had.

rcl compares that variable with the middleware it finds while it is being loaded, and ends the
process when they differ, so this is to be known before anything of ROS is loaded.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.config.ament_index import ament_prefixes
from play_launch.container.ros import RosSource
from play_launch.ros.fastdds.middleware import IMPLEMENTATION

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.container.ros import RosInstallation

VARIABLE: Final = "RMW_IMPLEMENTATION"
_SWITCH: Final = "librmw_implementation.so"
"""Loads the middleware that is asked for; every installation has it, the wheels do not."""


def middleware_problem(
    ros: RosInstallation, environ: Mapping[str, str] | None = None
) -> str | None:
    """Say why ROS would end every process that loads it, in a sentence; None when it would not.

    Without the switch rcl is linked to Fast DDS. Another middleware works all the same when its
    library is preloaded: it has the same functions, and is found first.

    Args:
        ros: Which ROS this is.
        environ: The environment; None for our own.
    """
    environ = os.environ if environ is None else environ
    asked_for = environ.get(VARIABLE, "")
    if not asked_for:
        return None
    library = f"lib{asked_for}.so"
    preloaded = environ.get("LD_PRELOAD", "").replace(":", " ").split()
    if library in {Path(entry).name for entry in preloaded}:
        return None
    found = _find(library, ros, environ)
    says = f"{VARIABLE} is {asked_for}, but "
    if ros.source is RosSource.SYSTEM or (ros.prefix / "lib" / _SWITCH).is_file():
        if found is not None:
            return None
        package = f"ros-{environ.get('ROS_DISTRO') or 'jazzy'}-{asked_for.replace('_', '-')}"
        return says + (
            f"{library} is neither in LD_LIBRARY_PATH nor in a prefix of AMENT_PREFIX_PATH: "
            f"install it (on Ubuntu: apt install {package}), or unset {VARIABLE}"
        )
    if asked_for == IMPLEMENTATION:
        return None
    says += f"rcl of the ROS wheels is linked to {IMPLEMENTATION}: "
    if found is None:
        return says + (
            f"unset {VARIABLE}, source a ROS installation that has that middleware, or build it "
            f"for the wheels and preload it (LD_PRELOAD=/path/to/{library})"
        )
    libraries = os.pathsep.join(map(str, ros.library_dirs))
    return says + (
        f"unset {VARIABLE}, or preload the other one (LD_PRELOAD={found}, with "
        f"LD_LIBRARY_PATH={libraries} in front of what is there)"
    )


def _find(library: str, ros: RosInstallation, environ: Mapping[str, str]) -> Path | None:
    folders = [
        *(Path(entry) for entry in environ.get("LD_LIBRARY_PATH", "").split(os.pathsep) if entry),
        *(prefix / "lib" for prefix in ament_prefixes(environ)),
        *ros.library_dirs,
    ]
    return next((path for folder in folders if (path := folder / library).is_file()), None)
