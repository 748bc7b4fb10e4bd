"""Parameters of a node, evaluated from their sources as its process does it.

As in rcl, a section counts where it is mentioned first, and within it the later value wins. So a
value that is given last may lose to one of an earlier file that names the node.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.resolve.parameter_files import matches
from play_launch.launch_files.parameter_text import ParameterTextError, read_sections
from play_launch.launch_files.reading import UnreadableError, text_of
from play_launch.launch_files.records import FOR_ALL, Section, Values

if TYPE_CHECKING:
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
    own: dict[str, Parameter] = {}
    unit.for_others = []
    for pattern, values in sections.items():
        if pattern == FOR_ALL or (unit.full_name and matches(pattern, unit.full_name)):
            own.update(values)
        elif values:
            unit.for_others.append(Section(pattern, tuple(values.values())))
    unit.parameters = list(own.values())


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
