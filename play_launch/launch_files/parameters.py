"""Parameters of a node, evaluated from their sources as its process does it.

As in rcl, a section counts where it is mentioned first, and within it the later value wins. So a
value that is given last may lose to one of an earlier file that names the node.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.model import FOR_ALL
from play_launch.config.resolve.parameter_files import matches
from play_launch.launch_files.parameter_text import ParameterTextError, read_sections
from play_launch.launch_files.reading import UnreadableError, text_of
from play_launch.launch_files.records import Process, Section, Values

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.launch_files.losses import Losses
    from play_launch.launch_files.records import Parameter, ParameterFile, Unit


def evaluate_sources(unit: Unit, losses: Losses) -> None:
    """Set `parameters` and `for_others` of a unit from its `sources`; report unreadable files."""
    sections: dict[str, dict[str, Parameter]] = {}
    for source in unit.sources:
        if isinstance(source, Values):
            found = [Section(source.pattern, source.parameters)]
        else:
            found = _sections_of(source, unit, losses)
        for section in found:
            values = sections.setdefault(section.pattern, {})
            values.update((each.name, each) for each in section.parameters)
    take_sections(
        unit, [Section(pattern, tuple(each.values())) for pattern, each in sections.items()]
    )


def take_sections(unit: Unit, sections: Iterable[Section]) -> None:
    """Give a node, and others in its process, what they get of sections in rcl's order.

    As rclcpp does it: of all sections that are for the node, in their order, the last value.
    """
    own: dict[str, Parameter] = {}
    for_others: list[Section] = []
    name = unit.full_name
    for section in sections:
        if section.pattern == FOR_ALL or (name and matches(section.pattern, name)):
            own.update({each.name: each for each in section.parameters})
        if section.pattern != name and section.parameters:
            for_others.append(section)
    unit.parameters = list(own.values())
    if isinstance(unit, Process):
        unit.for_others = for_others


def _sections_of(source: ParameterFile, unit: Unit, losses: Losses) -> list[Section]:
    name = source.path or "its parameter file"
    try:
        return read_sections(text_of(source.path) if source.text is None else source.text)
    except ParameterTextError as error:
        place = f"{name}:{error.line}" if source.path else f"{name}, line {error.line}"
        losses.lost(unit.described, f"{place}: {error}")
    except UnreadableError as error:
        losses.lost(unit.described, f"{name}: {error}")
    return []
