"""Evaluates a launch file: by ROS's own launch where it is installed, else by our evaluator."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.launch_files.ros_launch import evaluate as ros_launch

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from play_launch.launch_files.records import Description


def evaluate(
    path: Path, arguments: Mapping[str, str], *, limit: float, only_arguments: bool = False
) -> Description:
    """Return what a launch file describes; with `only_arguments` the arguments that it takes.

    `limit` is the seconds that it may take.

    Raises:
        LaunchFileError: When it cannot be evaluated, or is in Python and ROS's launch is missing.
        NotInstalledError: When our own programs are missing.
        OSError: When no process can be started.
    """
    if ros_launch.is_installed():
        return ros_launch.evaluate(path, arguments, limit=limit, only_arguments=only_arguments)
    from play_launch.launch_files.markup import evaluate as markup  # noqa: PLC0415 - not with ROS

    return markup.evaluate(path, arguments, limit=limit, only_arguments=only_arguments)
