"""The parameters of a node and of its process: by files, or value by value."""

from __future__ import annotations

from enum import Enum, auto
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from play_launch.config.model import FOR_ALL, ParameterConfig, ParameterType
from play_launch.config.problems import Location, Report
from play_launch.config.resolve.parameter_files import ParameterFileReader, matches
from play_launch.config.source import Refused, read_bytes
from play_launch.config.tree import Cursor, Scalar, ScalarKind
from play_launch.container.command import parameter_file_text
from play_launch.launch_files.configuration.yaml_text import Verbatim
from play_launch.launch_files.records import Composable, Losses, ParameterFile, Values, typed_value

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from play_launch.config.model import ParameterValue
    from play_launch.launch_files.configuration.files import Copies, Paths
    from play_launch.launch_files.configuration.options import Options
    from play_launch.launch_files.records import LaunchedProcess, Parameter, Source, Unit

Parameters = dict[str, "ParameterValue"]

_LONG: Final = 1000
"""Characters of a text that stands in a file of its own, such as the description of a robot."""


class _Use(Enum):
    """What of a file is read."""

    NAMED = auto()
    UNNAMED = auto()
    ALL = auto()


def values_of(unit: Unit, parameters: Iterable[Parameter], losses: Losses) -> Parameters:
    """Return the values of evaluated parameters of a unit."""
    found: Parameters = {}
    for each in parameters:
        try:
            value = typed_value(each)
        except ValueError:
            losses.lost(unit.described, f"the parameter {each.name} is not base64")
            continue
        if "\x00" in each.name or "\x00" in str(value.value):
            losses.lost(unit.described, f"the parameter {each.name!r} holds a NUL character")
        else:
            found[each.name] = value
    return found


class ParameterSources:
    """Writes parameters; one for a configuration, because files are read once.

    A file is referenced when our own reader finds in it what the node got of it, and at least as
    much as stands in the node's entry besides. So what `replay` gives the node is what it got,
    whatever the sources are. Temporary files are referenced as copies, where there may be any.
    """

    def __init__(self, options: Options, paths: Paths, copies: Copies | None) -> None:
        self._inline = options.inline
        self._paths = paths
        self._copies = copies
        self._report = Report()
        self._texts: dict[Path, bytes] = {}
        self._files = ParameterFileReader(self._report, self._content)
        self._unusable: set[tuple[str, _Use]] = set()

    def written(self, unit: Unit, values: Parameters) -> Any:
        """Return what stands at `parameters`; empty where there is nothing to say."""
        files: list[ParameterFile] = []
        base: Parameters = {}
        for source in self._usable(unit):
            found = self._read(source, unit.full_name or None)
            if found:
                files.append(source)
                base.update(found)
        overrides = _different(values, base)
        kept = len(values) - len(overrides)
        if not files or not base.keys() <= values.keys() or kept < max(1, len(overrides)):
            files, overrides = [], dict(values)
        references: list[Any] = [self._reference(unit, source) for source in files]
        references += self._set_apart(unit, overrides)
        if not references:
            return overrides
        return [*references, overrides] if overrides else references

    def sections(self, unit: Unit, sections: dict[str, Parameters]) -> Any:
        """Return what stands at `process_parameters`; empty where there is nothing to say.

        Its sources stand there in their order, in which rcl reads them too, and what differs behind
        them. A section for the node itself in a file does no harm: its `parameters` come later.
        """
        parts: list[Any] = []
        base: dict[str, Parameters] = {}
        for source in self._in_order(unit):
            found = self._sections_of(unit, source, sections)
            if found:
                parts.append(source if isinstance(source, ParameterFile) else dict(found))
                for pattern, values in found:
                    base.setdefault(pattern, {}).update(values)
        if unit.full_name not in sections:
            base.pop(unit.full_name, None)
        overrides = {
            pattern: rest
            for pattern, values in sections.items()
            if (rest := _different(values, base.get(pattern, {})))
        }
        fits = list(dict.fromkeys((*base, *sections))) == list(sections) and all(
            values.keys() <= sections[pattern].keys() for pattern, values in base.items()
        )
        given = [each for each in (*parts, overrides) if isinstance(each, dict)]
        count = sum(len(values) for each in given for values in each.values())
        total = sum(map(len, sections.values()))
        if not fits or total - count < max(1, count):
            return sections
        if overrides:
            parts.append(overrides)
        return [each if isinstance(each, dict) else self._reference(unit, each) for each in parts]

    def _in_order(self, unit: Unit) -> Iterable[Source]:
        """Return the sources that can be written, where one of them is a file."""
        files = set(self._usable(unit))
        return (each for each in unit.sources if isinstance(each, Values) or each in files)

    def _sections_of(
        self, unit: Unit, source: Source, wanted: Mapping[str, Parameters]
    ) -> list[tuple[str, Parameters]]:
        if isinstance(source, ParameterFile):
            return self._read_sections(source)
        # What cannot be written of them was reported with the rest.
        values = values_of(unit, source.parameters, Losses())
        return [(source.pattern, values)] if values and source.pattern in wanted else []

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

    def _content(self, path: Path) -> bytes | Refused:
        return self._texts[path] if path in self._texts else read_bytes(path)

    def _at(self, source: ParameterFile) -> Cursor:
        if source.text is not None:
            self._texts[Path(source.path)] = source.text.encode()
        start = Location(str(Path(source.path)), 1, 1)
        scalar = Scalar(start, ScalarKind.STRING, source.path, source.path, plain=False)
        return Cursor(scalar, "", self._report)

    def _read(self, source: ParameterFile, full_name: str | None) -> Parameters:
        use = _Use.UNNAMED if full_name is None else _Use.NAMED
        if not self._unusable.isdisjoint({(source.path, use), (source.path, _Use.ALL)}):
            return {}
        before = len(self._report)
        found = self._files.select(self._at(source), source.path, full_name)
        return found if self._is_fine(source, use, before) else {}

    def _read_sections(self, source: ParameterFile) -> list[tuple[str, Parameters]]:
        if not self._unusable.isdisjoint({(source.path, _Use.NAMED), (source.path, _Use.ALL)}):
            return []
        before = len(self._report)
        found = [each for each in self._files.sections(self._at(source), source.path) if each[1]]
        return found if self._is_fine(source, _Use.ALL, before) else []

    def _is_fine(self, source: ParameterFile, use: _Use, before: int) -> bool:
        """Return whether our reader accepts it; each mistake in a file is reported only once."""
        if len(self._report) == before:
            return True
        # It refuses something that rcl takes, such as `yes`.
        self._unusable.add((source.path, use))
        return False


def _different(values: Parameters, base: Parameters) -> Parameters:
    return {name: value for name, value in values.items() if not same(base.get(name), value)}


def same(one: ParameterValue | None, other: ParameterValue) -> bool:
    """Return whether two values are the same for a node."""
    # By text, because NaN is not NaN and 0.0 is -0.0.
    return one is not None and one.type is other.type and repr(one.value) == repr(other.value)


def add_parameters(
    entry: dict[str, Any], unit: LaunchedProcess, sources: ParameterSources, losses: Losses
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
    entry: dict[str, Any],
    unit: LaunchedProcess,
    own: Parameters,
    sources: ParameterSources,
    losses: Losses,
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


def _is_for(unit: LaunchedProcess, pattern: str) -> bool:
    return pattern == FOR_ALL or bool(unit.full_name and matches(pattern, unit.full_name))
