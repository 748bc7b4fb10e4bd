"""The fields of a foreign description, each taken once, and what they are turned into."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

from play_launch.config.compose import compose
from play_launch.config.model import ParameterType, ParameterValue
from play_launch.config.problems import Report, excerpt
from play_launch.config.resolve.parameters import flatten
from play_launch.config.tree import Cursor, Entry, Mapping, Sequence
from play_launch.launch_files.records import (
    LaunchOrigin,
    Parameter,
    ParameterFile,
    Place,
    Values,
    parameter,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.launch_files.records import Losses, Source, Unit

_INTEGER: Final = re.compile(r"[-+]?[0-9]+", re.ASCII)
_DOUBLE: Final = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?", re.ASCII)
_TRUTH: Final = {"true": True, "True": True, "false": False, "False": False}

_Values = dict[str, ParameterValue]


def typed_values(name: str, text: str) -> list[Parameter] | None:
    """Return the parameters that a text gives; None: no value.

    A mapping gives several, whose names are joined with dots.
    """
    found = _typed(name, text)
    return None if found is None else [parameter(*pair) for pair in found.items()]


def _typed(name: str, text: str) -> _Values | None:
    if text in _TRUTH:
        return {name: ParameterValue(ParameterType.BOOL, _TRUTH[text])}
    if _INTEGER.fullmatch(text) and -(2**63) <= int(text) < 2**63:
        return {name: ParameterValue(ParameterType.INTEGER, int(text))}
    if _DOUBLE.fullmatch(text) and not _INTEGER.fullmatch(text):
        return {name: ParameterValue(ParameterType.DOUBLE, float(text))}
    if text.lstrip().startswith(("[", "{")):
        found = _collection(name, text)
        if found is not None:
            return found or None
    return {name: ParameterValue(ParameterType.STRING, text)} if text else None


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


def origin_of(name: str) -> LaunchOrigin:
    """Return the origin for the name of a launch file, which may be empty."""
    return LaunchOrigin(Place(name))


def inline(name: str, text: str, where: str, losses: Losses) -> Source:
    """Return a source that holds one value, given as text."""
    return Values(parameters([(name, text)], where, losses))


def parameters(
    pairs: Iterable[tuple[str, str]], where: str, losses: Losses
) -> tuple[Parameter, ...]:
    """Return values that are given as text."""
    found: list[Parameter] = []
    for name, text in pairs:
        typed = typed_values(name, text)
        if typed is None:
            losses.lost(where, f"the parameter {name} has no value or no type")
        else:
            found += typed
    return tuple(found)


def file_text(text: str) -> Source:
    """Return a source that is the content of a parameter file."""
    return ParameterFile(text=text)


def set_name(node: Unit, name: str, namespace: str) -> None:
    """Give a node its name and namespace; a name may hold a namespace itself."""
    namespace = "/" + namespace.strip("/")
    before, slash, last = name.rpartition("/")
    if slash:
        namespace = before if name.startswith("/") else f"{namespace.rstrip('/')}/{before}"
    node.namespace = "/" + namespace.strip("/")
    node.name = last


class Fields:
    """The fields of a record, each taken once; what is left over was not understood."""

    def __init__(self, values: Any, where: str, losses: Losses) -> None:
        self._left: dict[str, Any] = dict(values) if isinstance(values, dict) else {}
        self.where = where
        self._losses = losses
        if not isinstance(values, dict):
            losses.lost(where, "is no record with fields")

    def take(self, name: str) -> Any:
        """Return a field as it is; None where it is missing."""
        return self._left.pop(name, None)

    def text(self, name: str) -> str:
        """Return a text; empty where it is missing."""
        value = self.take(name)
        if value is None or isinstance(value, str):
            return value or ""
        if isinstance(value, bool | int | float):
            return as_text(value)
        self._refuse(name, "a text")
        return ""

    def flag(self, name: str) -> bool | None:
        """Return a truth value; None where it is missing."""
        value = self.take(name)
        if value is None or isinstance(value, bool):
            return value
        self._refuse(name, "true or false")
        return None

    def number(self, name: str) -> float | None:
        """Return a number; None where it is missing."""
        value = self.take(name)
        if value is None or (isinstance(value, int | float) and not isinstance(value, bool)):
            return value
        self._refuse(name, "a number")
        return None

    def texts(self, name: str) -> list[str]:
        """Return a list of texts."""
        value = self.take(name)
        if value is None:
            return []
        if isinstance(value, list) and all(isinstance(each, str) for each in value):
            return list(value)
        self._refuse(name, "a list of texts")
        return []

    def pairs(self, name: str, keys: tuple[str, str] | None = None) -> list[tuple[str, str]]:
        """Return pairs of texts; they are lists of two, or records with the two `keys`."""
        value = self.take(name)
        if value is None:
            return []
        if isinstance(value, dict) and keys is None:
            value = [list(pair) for pair in value.items()]
        found: list[tuple[str, str]] = []
        for each in value if isinstance(value, list) else [None]:
            pair = [each.get(key) for key in keys] if keys and isinstance(each, dict) else each
            if (
                isinstance(pair, list)
                and len(pair) == 2
                and isinstance(pair[0], str)
                and isinstance(pair[1], str | bool | int | float | list)
            ):
                found.append((pair[0], as_text(pair[1])))
            else:
                self._refuse(name, "a list of pairs")
        return found

    def refuse_rest(self) -> None:
        """Report the unread fields that are not empty."""
        for name, value in self._left.items():
            if value not in (None, "", [], {}, False):
                self._losses.lost(self.where, f"the field {name} is not understood")

    def _refuse(self, name: str, expected: str) -> None:
        self._losses.lost(self.where, f"the field {name} is not {expected}")


def as_text(value: object) -> str:
    """Write a value as launch files do; a double keeps its point."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, list):
        return "[" + ", ".join(as_text(each) for each in value) + "]"
    return str(value)
