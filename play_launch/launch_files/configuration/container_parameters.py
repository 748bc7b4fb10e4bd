"""Parameters of a container's own process, as arguments of its command line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.model import ParameterConfig
from play_launch.install.parameter_file import ParameterFileError, parameter_text

if TYPE_CHECKING:
    from play_launch.launch_files.configuration.sources import Values
    from play_launch.launch_files.losses import Losses
    from play_launch.launch_files.records import Unit


def as_arguments(unit: Unit, values: Values, losses: Losses) -> list[str]:
    """Return `-p name:=value` for each; in ROS they hold for all nodes in the process as well."""
    words: list[str] = []
    for name, value in values.items():
        try:
            text = parameter_text(ParameterConfig(name, value))
        except ParameterFileError as error:
            losses.lost(unit.described, f"of the container's own node: {error}")
        else:
            words += ["-p", f"{name}:={text}"]
    return words
