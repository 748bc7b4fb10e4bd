"""The fields of a foreign description, each taken once, and the members that they describe."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, TypeVar

import msgspec

from play_launch.config.compose import compose
from play_launch.config.model import (
    FOR_ALL,
    ParameterConfig,
    ParameterSection,
    ParameterType,
    ParameterValue,
)
from play_launch.config.problems import Report, excerpt
from play_launch.config.resolve.parameters import flatten
from play_launch.config.tree import Cursor, Entry, Mapping, Sequence, resolve_scalar
from play_launch.launch_files.parameters import read_sections, take_sections
from play_launch.launch_files.records import (
    Composable,
    LaunchedProcess,
    ParameterFile,
    Place,
    Values,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from play_launch.launch_files.records import Losses, ProgramKind, Source, Unit

_TYPES: Final[dict[type, ParameterType]] = {
    bool: ParameterType.BOOL,
    int: ParameterType.INTEGER,
    float: ParameterType.DOUBLE,
}
_KEYS: Final = (("from", "to"), ("name", "value"))
"""Names of the two fields, where a pair is a record."""

_Values = dict[str, ParameterValue]
_Kind = TypeVar("_Kind")


def typed_values(name: str, text: str) -> _Values | None:
    """Return the parameters that a text gives, several for a mapping; None: no value or no type."""
    if text.lstrip().startswith(("[", "{")):
        found = _collection(name, text)
        if found is not None:
            return found or None
    try:
        _, value = resolve_scalar(text, None, plain=True)
    except ValueError:
        value = text
    kind = _TYPES.get(type(value))
    if kind is None or (isinstance(value, int) and not -(2**63) <= value < 2**63):
        return {name: ParameterValue(ParameterType.STRING, text)} if text else None
    return {name: ParameterValue(kind, value)}  # type: ignore[arg-type] # as its type says


def _collection(name: str, text: str) -> _Values | None:
    """Return what a list or mapping gives, empty where it has no type; None: it is neither."""
    report = Report()
    root = compose(text.strip(), excerpt(name), report)
    if len(report) > 0 or not isinstance(root, Mapping | Sequence):
        return None
    if isinstance(root, Sequence) and not root.items:
        return {}
    values = flatten(
        Cursor(Mapping(root.location, {name: Entry(name, root.location, root)}), "", report)
    )
    if len(report) == 0:
        return values
    numbers = [getattr(item, "value", None) for item in getattr(root, "items", ())]
    if numbers and all(isinstance(each, int | float) for each in numbers):
        doubles = tuple(float(each) for each in numbers if isinstance(each, int | float))
        return {name: ParameterValue(ParameterType.DOUBLE_ARRAY, doubles)}
    return None


class Fields:
    """The fields of a record, each taken once; what is left over was not understood."""

    def __init__(self, values: Any, where: str, losses: Losses) -> None:
        self._left: dict[str, Any] = dict(values) if isinstance(values, dict) else {}
        self.where = where
        self.losses = losses
        if not isinstance(values, dict):
            losses.lost(where, "is no record with fields")

    def take(self, name: str) -> Any:
        """Return a field as it is; None where it is missing."""
        return self._left.pop(name, None)

    def text(self, name: str) -> str:
        """Return a text; empty where it is missing."""
        value = self.take(name)
        if isinstance(value, bool | int | float):
            return as_text(value)
        if value is None or isinstance(value, str):
            return value or ""
        self._refuse(name, "expected a text")
        return ""

    def get(self, name: str, kind: type[_Kind]) -> _Kind | None:
        """Return a field of a type; None where it is missing or something else."""
        value = self.take(name)
        try:
            return None if value is None else msgspec.convert(value, kind)
        except msgspec.ValidationError as error:
            self._refuse(name, str(error))
            return None

    def pairs(self, name: str) -> list[tuple[str, str]]:
        """Return pairs of texts: a record, or a list of lists of two or of records with `_KEYS`."""
        value = self.take(name)
        if value is None:
            return []
        if isinstance(value, dict):
            value = list(value.items())
        found: list[tuple[str, str]] = []
        for each in value if isinstance(value, list) else [None]:
            match each:
                case {"from": key, "to": text} | {"name": key, "value": text} | [key, text] if (
                    isinstance(key, str) and isinstance(text, str | bool | int | float | list)
                ):
                    found.append((key, as_text(text)))
                case _:
                    self._refuse(name, "expected a list of pairs")
        return found

    def parameters(self, name: str) -> tuple[ParameterConfig, ...]:
        """Return values that are given as text."""
        return self.typed(self.pairs(name))

    def typed(self, pairs: Iterable[tuple[str, str]]) -> tuple[ParameterConfig, ...]:
        """Return parameters of names and texts."""
        found: list[ParameterConfig] = []
        for name, text in pairs:
            values = typed_values(name, text)
            if values is None:
                self.losses.lost(self.where, f"the parameter {name} has no value or no type")
            else:
                found += [ParameterConfig(*pair) for pair in values.items()]
        return tuple(found)

    def refuse_rest(self) -> None:
        """Report the unread fields that are not empty."""
        for name, value in self._left.items():
            if value not in (None, "", [], {}, False):
                self.losses.lost(self.where, f"the field {name} is not understood")

    def _refuse(self, name: str, problem: str) -> None:
        self.losses.lost(self.where, f"the field {name}: {problem}")


def as_text(value: object) -> str:
    """Write a value as launch files do; a double keeps its point."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, list):
        return "[" + ", ".join(as_text(each) for each in value) + "]"
    return str(value)


def read_unit(
    fields: Fields, kind: ProgramKind | None, file: str, filled: Callable[[str], str] = str
) -> Unit:
    """Return the member that a record of `file` describes; without a kind a composable node.

    `filled` puts the values of variables into texts.
    """
    unit: Unit = Composable() if kind is None else LaunchedProcess(kind=kind)
    _set_name(unit, fields.text("node_name") or fields.text("name"), fields.text("namespace"))
    if unit.name and fields.where != unit.full_name:
        fields.where += f" {unit.full_name}"
    unit.where = fields.where
    unit.origin = Place(file)
    unit.package = fields.text("package")
    unit.remappings = fields.pairs("remaps")
    environment = fields.pairs("env")
    if isinstance(unit, Composable):
        if environment:
            what = "environment variables: it shares those of its container"
            fields.losses.lost(unit.where, what)
        unit.plugin = fields.text("plugin")
        unit.container = fields.text("target_container_name")
        unit.log_level = fields.text("log_level")
        unit.extra_arguments = list(fields.parameters("extra_args"))
    else:
        unit.environment = environment
        unit.executable = filled(fields.text("executable"))
        unit.arguments = [filled(each) for each in fields.get("args", list[str]) or ()]
        unit.ros_arguments = [filled(each) for each in fields.get("ros_args", list[str]) or ()]
        command = fields.get("cmd", list[str])
        if not unit.package and command:
            # As that program does it: the first word is a whole command line.
            unit.command = [*command[0].split(), *command[1:]]
        unit.respawn = bool(fields.get("respawn", bool))
        unit.respawn_delay = fields.get("respawn_delay", float)
    unit.sources = _sources(fields)
    _evaluate(unit, fields.losses)
    return unit


def _set_name(unit: Unit, name: str, namespace: str) -> None:
    """Give a node its name and namespace; a name may hold a namespace itself."""
    namespace = "/" + namespace.strip("/")
    before, slash, last = name.rpartition("/")
    if slash:
        namespace = before if name.startswith("/") else f"{namespace.rstrip('/')}/{before}"
    unit.namespace = "/" + namespace.strip("/")
    unit.name = last


def _sources(fields: Fields) -> list[Source]:
    common: list[Source] = [Values((each,)) for each in fields.parameters("global_params")]
    values: list[Source] = [Values((each,)) for each in fields.parameters("params")]
    files: list[Source] = [
        ParameterFile(text=text) for text in fields.get("params_files", list[str]) or ()
    ]
    # Without the ordered list, what stands in the launch file itself comes last.
    return common + (_ordered_sources(fields) or files + common + values)


def _ordered_sources(fields: Fields) -> list[Source]:
    found: list[Source] = []
    sources = fields.take("param_sources") or []
    for each in sources if isinstance(sources, list) else [sources]:
        match each:
            case {"kind": "inline", "name": str(name), "value": value}:
                found.append(Values(fields.typed([(name, as_text(value))])))
            case {"kind": "file", "content": str(content)}:
                found.append(ParameterFile(text=content))
            case _:
                what = "a source of parameters is neither a value nor a file"
                fields.losses.lost(fields.where, what)
    return found


def _evaluate(unit: Unit, losses: Losses) -> None:
    """Give a node what it gets of its sources; a section counts where it is mentioned first."""
    report = Report()
    sections: dict[str, _Values] = {}
    for source in unit.sources:
        if isinstance(source, Values):
            values = {each.name: each.value for each in source.parameters}
            sections.setdefault(FOR_ALL, {}).update(values)
            continue
        for pattern, values in read_sections(source, report):
            sections.setdefault(pattern, {}).update(values)
    for problem in report:
        losses.lost(unit.described, str(problem))
    take_sections(
        unit,
        [
            ParameterSection(pattern, tuple(map(ParameterConfig, values, values.values())))
            for pattern, values in sections.items()
        ],
    )
