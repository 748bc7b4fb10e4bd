"""The parameters of a node as a configuration gives them: by files, or value by value."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from play_launch.config.problems import Place, Report
from play_launch.config.resolve.parameter_files import ParameterFiles
from play_launch.config.yaml.scalars import ScalarKind
from play_launch.config.yaml.tree import At, Scalar
from play_launch.launch_files.configuration.yaml_text import Verbatim
from play_launch.launch_files.records import ParameterFile, typed_value

if TYPE_CHECKING:
    from play_launch.config.model import ParameterValue
    from play_launch.launch_files.configuration.options import Options
    from play_launch.launch_files.configuration.paths import Paths
    from play_launch.launch_files.losses import Losses
    from play_launch.launch_files.records import Unit

Values = dict[str, "ParameterValue"]


def values_of(unit: Unit, losses: Losses) -> Values:
    """Return the evaluated parameters of a unit."""
    found: Values = {}
    for each in unit.parameters:
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
    whatever the sources are.
    """

    def __init__(self, options: Options, paths: Paths) -> None:
        self._inline = options.inline
        self._paths = paths
        self._report = Report()
        self._files = ParameterFiles(self._report)
        self._unusable: set[tuple[str, bool]] = set()

    def written(self, unit: Unit, values: Values) -> Any:
        """Return what stands at `parameters`; empty where there is nothing to say."""
        paths: list[str] = []
        base: Values = {}
        for source in () if self._inline else unit.sources:
            if isinstance(source, ParameterFile) and source.text is None and source.path:
                found = self._read(source.path, unit.full_name or None)
                if found and source.path not in paths:
                    paths.append(source.path)
                    base.update(found)
        overrides = {
            name: value for name, value in values.items() if not _same(base.get(name), value)
        }
        kept = len(values) - len(overrides)
        if not paths or not base.keys() <= values.keys() or kept < max(1, len(overrides)):
            return dict(values)
        references: list[Any] = [Verbatim(self._paths.value(path)) for path in paths]
        return [*references, overrides] if overrides else references

    def _read(self, path: str, full_name: str | None) -> Values:
        if (path, full_name is None) in self._unusable:
            return {}
        before = len(self._report)
        start = Place(str(Path(path)), 1, 1)
        at = At(Scalar(start, ScalarKind.STRING, path, path, plain=False), "", self._report)
        found = self._files.select(at, path, full_name)
        if len(self._report) > before:
            # Our reader refuses something that rcl takes, such as `yes`.
            self._unusable.add((path, full_name is None))
            return {}
        return found


def _same(one: ParameterValue | None, other: ParameterValue) -> bool:
    # By text, because NaN is not NaN and 0.0 is -0.0.
    return one is not None and one.type is other.type and repr(one.value) == repr(other.value)
