"""The parameters of a node and of its process: by files, or value by value."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from play_launch.config.model import FOR_ALL, ParameterConfig, ParameterType
from play_launch.config.problems import Report
from play_launch.container.parameter_files import parameter_file_text
from play_launch.launch_files.configuration.yaml_text import Verbatim
from play_launch.launch_files.parameters import is_for, read_sections
from play_launch.launch_files.records import Composable, Losses, ParameterFile, Values

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.config.model import ParameterValue
    from play_launch.launch_files.configuration.files import Copies, Paths
    from play_launch.launch_files.configuration.request import Options
    from play_launch.launch_files.records import LaunchedProcess, Source, Unit

Parameters = dict[str, "ParameterValue"]
Sections = dict[str, Parameters]
_Part = tuple["Source", Sections]

_LONG: Final = 1000
"""Characters of a text that stands in a file of its own, such as the description of a robot."""


class ParameterSources:
    """Writes parameters; one for a configuration, because files are read once.

    A file is referenced when our own reader finds in it what the node got of it, and at least as
    much as stands in the node's entry besides. So what `replay` gives the node is what it got,
    whatever the sources are. Temporary files are referenced as copies, where there may be any.
    """

    def __init__(
        self, options: Options, paths: Paths, copies: Copies | None, losses: Losses
    ) -> None:
        self._inline = options.inline
        self._paths = paths
        self._copies = copies
        self._losses = losses
        self._read: dict[ParameterFile, Sections] = {}

    def values_of(self, unit: Unit, parameters: Iterable[ParameterConfig]) -> Parameters:
        """Return the values of evaluated parameters of a unit."""
        found: Parameters = {}
        for each in parameters:
            if "\x00" in each.name or "\x00" in str(each.value.value):
                what = f"the parameter {each.name!r} holds a NUL character"
                self._losses.lost(unit.described, what)
            else:
                found[each.name] = each.value
        return found

    def add(self, entry: dict[str, Any], unit: LaunchedProcess) -> None:
        """Add `parameters`, and `process_parameters` where others in it get something."""
        own = self.values_of(unit, unit.parameters)
        # Replay gives what is for the node to all nodes of the process.
        has_others = not all(is_for(unit, each.pattern) for each in unit.for_others)
        is_named = bool(unit.package and unit.name)
        if (is_named or not has_others) and (written := self.written(unit, own)):
            entry["parameters"] = written
        if has_others:
            self.add_sections(entry, unit, {} if is_named else own)

    def add_sections(self, entry: dict[str, Any], unit: LaunchedProcess, own: Parameters) -> None:
        """Add `process_parameters`, and `own` for the node where these do not give it that."""
        sections = {each.pattern: self.values_of(unit, each.parameters) for each in unit.for_others}
        given: Parameters = {}
        for pattern, values in sections.items():
            if is_for(unit, pattern):
                given |= values
        if rest := _different(own, given):
            sections[unit.full_name or FOR_ALL] = rest
        if written := self._sections(unit, sections):
            entry["process_parameters"] = written

    def written(self, unit: Unit, values: Parameters) -> Any:
        """Return what stands at `parameters`; empty where there is nothing to say."""
        parts: list[_Part] = [
            (source, {FOR_ALL: found})
            for source in self._usable(unit)
            if (found := self._for_node(unit, source))
        ]
        references, rest = self._split(unit, parts, {FOR_ALL: values})
        overrides = dict(rest.get(FOR_ALL, {}))
        references += self._set_apart(unit, overrides)
        if not references:
            return overrides
        return [*references, overrides] if overrides else references

    def _sections(self, unit: Unit, sections: Sections) -> Any:
        """Return what stands at `process_parameters`; empty where there is nothing to say.

        Its sources stand there in their order, in which rcl reads them too, and what differs behind
        them. A section for the node itself in a file does no harm: its `parameters` come later.
        """
        usable = set(self._usable(unit))
        parts: list[_Part] = []
        for source in unit.sources:
            found: Sections = {}
            if isinstance(source, Values) and source.pattern in sections:
                found = {source.pattern: self.values_of(unit, source.parameters)}
            elif isinstance(source, ParameterFile) and source in usable:
                found = self._sections_of(source)
            own = unit.full_name if unit.full_name not in sections else ""
            if found := {name: each for name, each in found.items() if each and name != own}:
                parts.append((source, found))
        references, rest = self._split(unit, parts, sections)
        return [*references, rest] if references and rest else references or rest

    def _split(
        self, unit: Unit, parts: list[_Part], wanted: Sections
    ) -> tuple[list[Any], Sections]:
        """Return parts that hold most of what is wanted, and what differs; else all of it."""
        base: Sections = {}
        for _, found in parts:
            for pattern, values in found.items():
                base.setdefault(pattern, {}).update(values)
        rest = {
            pattern: differing
            for pattern, values in wanted.items()
            if (differing := _different(values, base.get(pattern, {})))
        }
        fits = list(dict.fromkeys((*base, *wanted))) == list(wanted) and all(
            values.keys() <= wanted[pattern].keys() for pattern, values in base.items()
        )
        given = [rest, *(found for source, found in parts if isinstance(source, Values))]
        count = sum(len(values) for each in given for values in each.values())
        if not fits or sum(map(len, wanted.values())) - count < max(1, count):
            return [], wanted
        return [
            self._reference(unit, source) if isinstance(source, ParameterFile) else found
            for source, found in parts
        ], rest

    def _usable(self, unit: Unit) -> Iterable[ParameterFile]:
        """Return the parameter files of a unit that can be named, each once."""
        if self._inline:
            return []
        files = (each for each in unit.sources if isinstance(each, ParameterFile) and each.path)
        has_copies = self._copies is not None
        return dict.fromkeys(each for each in files if each.text is None or has_copies)

    def _reference(self, unit: Unit, source: ParameterFile) -> Verbatim:
        if source.text is None:
            return Verbatim(self._paths.value(source.path))
        return self._copy(unit, source.text)

    def _copy(self, unit: Unit, text: str) -> Verbatim:
        assert self._copies is not None
        program = unit.plugin if isinstance(unit, Composable) else unit.executable
        name = f"{unit.name or program.rpartition('::')[2] or 'parameters'}.yaml"
        return Verbatim(self._paths.value(self._copies.add(name, text.encode())))

    def _set_apart(self, unit: Unit, values: Parameters) -> list[Verbatim]:
        """Take texts that are too long to be read in between out of `values`, into a file."""
        if self._copies is None:
            return []
        long = {
            name: value
            for name, value in values.items()
            if value.type is ParameterType.STRING and len(str(value.value)) >= _LONG
        }
        if not long:
            return []
        for name in long:
            del values[name]
        parameters = [ParameterConfig(name, value) for name, value in long.items()]
        return [self._copy(unit, parameter_file_text([(FOR_ALL, parameters)]))]

    def _for_node(self, unit: Unit, source: ParameterFile) -> Parameters:
        """Return what a file holds for a node; nothing where it has no name to find that by."""
        found = self._sections_of(source)
        if not unit.full_name and found.keys() != {FOR_ALL}:
            return {}
        values: Parameters = {}
        for pattern, each in found.items():
            if is_for(unit, pattern):
                values |= each
        return values

    def _sections_of(self, source: ParameterFile) -> Sections:
        """Return what our reader finds in a file; nothing where it refuses what rcl takes."""
        if source not in self._read:
            report = Report()
            found: Sections = {}
            for pattern, values in read_sections(source, report):
                found.setdefault(pattern, {}).update(values)
            self._read[source] = {} if len(report) else found
        return self._read[source]


def _different(values: Parameters, base: Parameters) -> Parameters:
    return {name: value for name, value in values.items() if not _same(base.get(name), value)}


def _same(one: ParameterValue | None, other: ParameterValue) -> bool:
    """Return whether two values are the same for a node."""
    # By text, because NaN is not NaN and 0.0 is -0.0.
    return one is not None and one.type is other.type and repr(one.value) == repr(other.value)
