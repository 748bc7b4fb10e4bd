"""What all nodes of a process get: the sections that its `parameters` do not say."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from play_launch.config.model import FOR_ALL
from play_launch.config.resolve.parameter_files import matches
from play_launch.launch_files.configuration.sources import same, values_of

if TYPE_CHECKING:
    from play_launch.launch_files.configuration.sources import Parameters, ParameterSources
    from play_launch.launch_files.losses import Losses
    from play_launch.launch_files.records import Process


def add_parameters(
    entry: dict[str, Any], unit: Process, sources: ParameterSources, losses: Losses
) -> None:
    """Add `parameters` of a process, and `process_parameters` where others in it get something."""
    own = values_of(unit, unit.parameters, losses)
    is_named = bool(unit.package and unit.name)
    if all(_is_for(unit, each.pattern) for each in unit.for_others):
        # Replay gives those to all nodes of the process.
        if written := sources.written(unit, own):
            entry["parameters"] = written
        return
    if is_named and (written := sources.written(unit, own)):
        entry["parameters"] = written
    add_sections(entry, unit, {} if is_named else own, sources, losses)


def add_sections(
    entry: dict[str, Any], unit: Process, own: Parameters, sources: ParameterSources, losses: Losses
) -> None:
    """Add `process_parameters`, and `own` for the node itself, where these do not give it that."""
    sections = {each.pattern: values_of(unit, each.parameters, losses) for each in unit.for_others}
    given: Parameters = {}
    for pattern, values in sections.items():
        if _is_for(unit, pattern):
            given |= values
    if rest := {name: value for name, value in own.items() if not same(given.get(name), value)}:
        sections[unit.full_name or FOR_ALL] = rest
    if written := sources.sections(unit, sections):
        entry["process_parameters"] = written


def _is_for(unit: Process, pattern: str) -> bool:
    return pattern == FOR_ALL or bool(unit.full_name and matches(pattern, unit.full_name))
