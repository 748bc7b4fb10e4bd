"""Parameters that a node gets of sections, and sections as our reader of files has them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.model import FOR_ALL, ParameterConfig, ParameterSection
from play_launch.config.problems import Location
from play_launch.config.resolve.parameter_files import ParameterFileReader, matches
from play_launch.config.source import Refused, read_bytes
from play_launch.config.tree import Cursor, Scalar, ScalarKind
from play_launch.launch_files.records import LaunchedProcess

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from play_launch.config.model import ParameterValue
    from play_launch.config.problems import Report
    from play_launch.launch_files.records import ParameterFile, Unit


def read_sections(
    source: ParameterFile, report: Report
) -> list[tuple[str, dict[str, ParameterValue]]]:
    """Return what `replay` finds in a parameter file; mistakes go into the report."""

    def read(path: Path) -> bytes | Refused:
        return read_bytes(path) if source.text is None else source.text.encode()

    path = source.path or "its parameter file"
    scalar = Scalar(Location(path, 1, 1), ScalarKind.STRING, path, path, plain=False)
    return ParameterFileReader(report, read).sections(Cursor(scalar, "", report), path)


def is_for(unit: Unit, pattern: str) -> bool:
    """Return whether a section is for the node of a unit."""
    return pattern == FOR_ALL or bool(unit.full_name and matches(pattern, unit.full_name))


def take_sections(unit: Unit, sections: Iterable[ParameterSection]) -> None:
    """Give a node, and others in its process, what they get of sections in rcl's order.

    As rclcpp does it: of all sections that are for the node, in their order, the last value.
    """
    own: dict[str, ParameterConfig] = {}
    for_others: list[ParameterSection] = []
    for section in sections:
        if is_for(unit, section.pattern):
            own.update({each.name: each for each in section.parameters})
        if section.pattern != unit.full_name and section.parameters:
            for_others.append(section)
    unit.parameters = list(own.values())
    if isinstance(unit, LaunchedProcess):
        unit.for_others = for_others
