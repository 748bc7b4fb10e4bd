"""The environment that a container or a node is started with."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING

from play_launch.container.ros import RosSource

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from play_launch.container.ros import RosInstallation

BOOTSTRAP_MARK = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""Set by the wheels' start-up hook once LD_LIBRARY_PATH holds what they need.

We hand the mark on to children of our own environment, because the LD_LIBRARY_PATH that goes
with it is complete: without it each Python there would start twice (16 ms), and the hook would
write the folders in an order that changes with every start. It must not reach a Python of another
environment, see `foreign_python_environment`.
"""

_DEFAULTS = {
    # Lines, not blocks: a line that stays in a buffer is lost when its process is killed.
    "RCUTILS_LOGGING_BUFFERED_STREAM": "0",
    # Our output is read by a program, which puts colour on it itself.
    "RCUTILS_COLORIZED_OUTPUT": "0",
    # The same for print() in nodes written in Python; others take no notice.
    "PYTHONUNBUFFERED": "1",
}
_COERCED = {"C.UTF-8", "C.utf8", "UTF-8"}
"""What Python sets LC_CTYPE to in the C locale, see PEP 538."""
_PYTHON = re.compile(r"python(\d+(\.\d+)*)?")


def child_environment(
    base: Mapping[str, str],
    ros: RosInstallation,
    declared: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """Make the environment of a child.

    Our prefix comes first in AMENT_PREFIX_PATH, our libraries first in LD_LIBRARY_PATH; with
    wheels our programs are in PATH, so that `python3` is the one that has rclpy even if the
    environment was not activated.

    Args:
        base: The environment to start from, usually our own.
        ros: Which ROS this is.
        declared: What the configuration says; it wins over everything else.
    """
    environment = {**_DEFAULTS, **base}
    _prepend(environment, "LD_LIBRARY_PATH", ros.library_dirs)
    _prepend(environment, "AMENT_PREFIX_PATH", [ros.prefix])
    if ros.source is RosSource.WHEELS:
        programs = os.fspath(ros.prefix / "bin")
        if programs not in environment.get("PATH", "").split(os.pathsep):
            _prepend(environment, "PATH", [ros.prefix / "bin"])
        environment[BOOTSTRAP_MARK] = "1"
    environment.update(declared or {})
    return environment


def foreign_python_environment(
    environment: Mapping[str, str], ros: RosInstallation, program: Path
) -> dict[str, str]:
    """Undo our wheels for a Python of another environment, which must find its own.

    Such a Python would take the mark for its own, skip its start-up hook and load our libraries
    under its modules. Everything else, and every other program, keeps the environment.

    Args:
        environment: What `child_environment` made.
        ros: Which ROS this is.
        program: The interpreter as it will be executed, found in PATH and not resolved: the
            programs of most environments are symbolic links to one Python.
    """
    changed = dict(environment)
    is_python = _PYTHON.fullmatch(program.name) is not None
    if ros.source is RosSource.SYSTEM or not is_python or program.is_relative_to(ros.prefix):
        return changed
    changed.pop(BOOTSTRAP_MARK, None)
    _remove(changed, "LD_LIBRARY_PATH", ros.library_dirs)
    _remove(changed, "AMENT_PREFIX_PATH", [ros.prefix])
    return changed


def caller_environment(environment: Mapping[str, str], ros: RosInstallation) -> dict[str, str]:
    """Undo in our own environment what was put into it while this Python came up.

    What the caller had set to the same is undone as well.
    """
    changed = dict(environment)
    if changed.get("LC_CTYPE") in _COERCED:
        del changed["LC_CTYPE"]
    if changed.pop(BOOTSTRAP_MARK, None) is not None:
        _remove(changed, "LD_LIBRARY_PATH", ros.library_dirs)
    return changed


def _prepend(environment: dict[str, str], name: str, paths: Iterable[Path]) -> None:
    present = [entry for entry in environment.get(name, "").split(os.pathsep) if entry]
    entries = dict.fromkeys([*map(os.fspath, paths), *present])
    environment[name] = os.pathsep.join(entries)


def _remove(environment: dict[str, str], name: str, paths: Iterable[Path]) -> None:
    unwanted = {os.fspath(path) for path in paths}
    entries = [entry for entry in environment.get(name, "").split(os.pathsep) if entry]
    kept = [entry for entry in entries if entry not in unwanted]
    if kept:
        environment[name] = os.pathsep.join(kept)
    else:
        environment.pop(name, None)
