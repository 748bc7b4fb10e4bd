"""Where ROS is, and where our own programs are.

ROS comes either from a sourced installation (`/opt/ros/...`, a workspace: then AMENT_PREFIX_PATH
names it) or from wheels in the environment of this very Python. Both at once mix libraries of
two builds in one process, which causes inexplicable crashes, so it is refused.
"""

from __future__ import annotations

import os
import sys
import sysconfig
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch import UserError
from play_launch.config.substitutions import ament_prefixes
from play_launch.ros.fastdds.middleware import IMPLEMENTATION

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_PROGRAMS = Path("lib") / "play_launch_container"
_RCLPY = "_rclpy_pybind11"
"""The compiled part of rclpy."""
_MARKER = Path("share") / "rcl" / "package.xml"


class NotInstalledError(UserError):
    """Something this program needs is missing; the text includes the fix."""


class MixedInstallationError(UserError):
    """ROS is there twice."""

    def __init__(self, prefix: Path, sourced: Sequence[Path]) -> None:
        super().__init__(
            f"ROS is installed twice: as wheels in {prefix} and sourced from "
            f"{', '.join(map(str, sourced))}. Start again in a shell in which nothing is sourced "
            "(AMENT_PREFIX_PATH is empty), or in an environment without the extra 'jazzy'"
        )
        self.prefix = prefix
        self.sourced = tuple(sourced)


class RosSource(StrEnum):
    """Where ROS comes from."""

    SYSTEM = "system"
    """A sourced installation."""
    WHEELS = "wheels"
    """Python packages in our own environment."""


@dataclass(frozen=True, slots=True)
class RosInstallation:
    """The facts about the ROS that this Python uses.

    Attributes:
        source: Where it comes from.
        prefix: Where our own files are installed (`sys.prefix`); with wheels ROS is there, too.
        library_dirs: What native programs need in LD_LIBRARY_PATH, most important first. With a
            sourced ROS only our own: its setup files have named the others already.
    """

    source: RosSource
    prefix: Path
    library_dirs: tuple[Path, ...]


def ros_installation(
    environ: Mapping[str, str] | None = None,
    *,
    prefix: Path | None = None,
    site_packages: Path | None = None,
) -> RosInstallation:
    """Find out which ROS this is.

    Args:
        environ: The environment; None for our own.
        prefix: Prefix of the Python environment; None for our own.
        site_packages: Where its packages are; None for our own.

    Raises:
        MixedInstallationError: When ROS is sourced and there as wheels, too.
        NotInstalledError: When it is neither.
    """
    environ = os.environ if environ is None else environ
    prefix = Path(sys.prefix) if prefix is None else prefix
    if site_packages is None:
        site_packages = Path(sysconfig.get_path("platlib"))
    sourced = [
        entry
        for entry in ament_prefixes(environ)
        if _holds_rcl(entry) and not _is_same(entry, prefix)
    ]
    # An interface package or a component of our own does not make an environment one with wheels.
    wheels = _holds_rcl(prefix) and (site_packages / "rclpy").is_dir()
    if wheels and sourced:
        raise MixedInstallationError(prefix, sourced)
    if wheels:
        bundled = sorted(path for path in site_packages.glob("ros_*.libs") if path.is_dir())
        return RosInstallation(RosSource.WHEELS, prefix, (prefix / "lib", *bundled))
    if sourced:
        return RosInstallation(RosSource.SYSTEM, prefix, (prefix / "lib",))
    raise NotInstalledError(
        "there is no ROS 2: source an installation (source /opt/ros/jazzy/setup.sh), or install "
        "the wheels into this environment (pip install 'play-launch-py[jazzy]')"
    )


def _program(
    name: str, environ: Mapping[str, str] | None = None, *, prefix: Path | None = None
) -> Path:
    """Find a program of ours.

    Raises:
        NotInstalledError: When it is nowhere.
    """
    environ = os.environ if environ is None else environ
    prefix = Path(sys.prefix) if prefix is None else prefix
    for entry in dict.fromkeys([prefix, *ament_prefixes(environ)]):
        path = entry / _PROGRAMS / name
        if path.is_file() and os.access(path, os.X_OK):
            return path
    raise NotInstalledError(
        f"the program {name} is neither in {prefix / _PROGRAMS} nor in a prefix of "
        "AMENT_PREFIX_PATH: pip install play-launch-container, in a checkout pip install "
        "./container_native"
    )


component_container = partial(_program, "component_container")
"""Find the container's program."""
spawn_guard = partial(_program, "spawn_guard")
"""Find the parent of all processes of a session."""
topic_recorder = partial(_program, "topic_recorder")
"""Find the program that records topics."""


def rclpy_problem() -> str | None:
    """Describe why this Python has no rclpy, without importing it; else None.

    The compiled part is looked for as well: that of another version of Python, as of a sourced
    installation in an environment that has its own Python, cannot be loaded.
    """
    spec = find_spec("rclpy")
    if spec is None:
        return "there is no package rclpy"
    folders = [Path(folder) for folder in spec.submodule_search_locations or ()]
    compiled = [folder / f"{_RCLPY}{suffix}" for folder in folders for suffix in EXTENSION_SUFFIXES]
    if any(path.is_file() for path in compiled):
        return None
    return (
        f"{_RCLPY} in {', '.join(map(str, folders)) or 'rclpy'} is not for Python "
        f"{sys.version_info.major}.{sys.version_info.minor}"
    )


def log_folder(environ: Mapping[str, str]) -> Path | None:
    """Return where ROS writes its log files, as rcl_logging finds it; None without HOME."""
    home = environ.get("HOME", "")
    base = environ.get("ROS_HOME") or (home and f"{home}/.ros")
    name = environ.get("ROS_LOG_DIR") or (base and f"{base}/log")
    if not name:
        return None
    return Path(home + name[1:] if name[0] == "~" else name)


def _holds_rcl(prefix: Path) -> bool:
    return (prefix / _MARKER).is_file()


def _is_same(one: Path, other: Path) -> bool:
    try:
        return one.samefile(other)
    except OSError:
        return False


RMW_VARIABLE: Final = "RMW_IMPLEMENTATION"
_SWITCH: Final = "librmw_implementation.so"
"""Loads the middleware that is asked for; every installation has it, the wheels do not."""


def middleware_problem(
    ros: RosInstallation, environ: Mapping[str, str] | None = None
) -> str | None:
    """Describe why ROS would abort each process that loads it; None if it would not.

    Without the switch rcl is linked to Fast DDS. Another middleware works all the same when its
    library is preloaded: it has the same functions, and is found first.

    Args:
        ros: Which ROS this is.
        environ: The environment; None for our own.
    """
    environ = os.environ if environ is None else environ
    asked_for = environ.get(RMW_VARIABLE, "")
    if not asked_for:
        return None
    library = f"lib{asked_for}.so"
    preloaded = environ.get("LD_PRELOAD", "").replace(":", " ").split()
    if library in {Path(entry).name for entry in preloaded}:
        return None
    found = _find(library, ros, environ)
    says = f"{RMW_VARIABLE} is {asked_for}, but "
    if ros.source is RosSource.SYSTEM or (ros.prefix / "lib" / _SWITCH).is_file():
        if found is not None:
            return None
        package = f"ros-{environ.get('ROS_DISTRO') or 'jazzy'}-{asked_for.replace('_', '-')}"
        return says + (
            f"{library} is neither in LD_LIBRARY_PATH nor in a prefix of AMENT_PREFIX_PATH: "
            f"install it (on Ubuntu: apt install {package}), or unset {RMW_VARIABLE}"
        )
    if asked_for == IMPLEMENTATION:
        return None
    says += f"rcl of the ROS wheels is linked to {IMPLEMENTATION}: "
    if found is None:
        return says + (
            f"unset {RMW_VARIABLE}, source a ROS installation that has that middleware, or build "
            f"it for the wheels and preload it (LD_PRELOAD=/path/to/{library})"
        )
    libraries = os.pathsep.join(map(str, ros.library_dirs))
    return says + (
        f"unset {RMW_VARIABLE}, or preload the other one (LD_PRELOAD={found}, with "
        f"LD_LIBRARY_PATH={libraries} in front of what is there)"
    )


def _find(library: str, ros: RosInstallation, environ: Mapping[str, str]) -> Path | None:
    folders = [
        *(Path(entry) for entry in environ.get("LD_LIBRARY_PATH", "").split(os.pathsep) if entry),
        *(prefix / "lib" for prefix in ament_prefixes(environ)),
        *ros.library_dirs,
    ]
    return next((path for folder in folders if (path := folder / library).is_file()), None)
