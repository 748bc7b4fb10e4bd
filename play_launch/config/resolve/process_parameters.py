"""Parameters for all nodes of a process: sections as in parameter files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.model import ParameterConfig, ParameterSection
from play_launch.config.problems import excerpt
from play_launch.config.resolve.parameter_files import PATTERN
from play_launch.config.resolve.parameters import flatten
from play_launch.config.yaml.tree import Mapping, Sequence, describe_node

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.config.model import ParameterValue
    from play_launch.config.resolve.parameter_files import ParameterFiles
    from play_launch.config.yaml.tree import At

_FORM = "a mapping of names of nodes to parameters"


def resolve_process_parameters(
    at: At | None, files: ParameterFiles
) -> tuple[ParameterSection, ...]:
    """Return the sections from the sources that stand there: mappings, and parameter files.

    As in rcl, a section counts where it is mentioned first, and within it the later value wins.
    """
    if at is None:
        return ()
    found: dict[str, dict[str, ParameterValue]] = {}
    for source in _sources(at):
        for pattern, values in _sections(source, files):
            found.setdefault(pattern, {}).update(values)
    return tuple(
        ParameterSection(
            pattern, tuple(ParameterConfig(name, value) for name, value in values.items())
        )
        for pattern, values in found.items()
        if values
    )


def _sources(at: At) -> Iterable[At]:
    if isinstance(at.node, Mapping):
        return [at]
    if isinstance(at.node, Sequence) and at.node.array_tag is None:
        return at.elements()
    if not at.is_invalid:
        fix = "; put the file into a list: [ ... ]" if at.string is not None else ""
        at.problem(f"expected {_FORM}, or a list, given {describe_node(at.node)}{fix}")
    return []


def _sections(source: At, files: ParameterFiles) -> Iterable[tuple[str, dict[str, ParameterValue]]]:
    if source.string is not None:
        yield from files.sections(source, source.string)
        return
    if not isinstance(source.node, Mapping):
        source.expected(f"{_FORM}, or the path of a parameter file")
        return
    for entry, value in source.entries():
        pattern = f"/{entry.key.removeprefix('/')}"
        if not PATTERN.fullmatch(pattern):
            message = (
                f"{excerpt(entry.key)} is not the full name of a node, nor a pattern such as /**"
            )
            value.problem(message, entry.place)
        elif isinstance(value.node, Mapping):
            yield pattern, flatten(value)
        else:
            value.expected("parameter names and values")
