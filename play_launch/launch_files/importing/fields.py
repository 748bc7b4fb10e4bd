"""The fields of a foreign description, each taken once, and what they are turned into."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from play_launch.launch_files.importing.parameters import typed_values
from play_launch.launch_files.records import Origin, Parameter, ParameterFile, Place, Values

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.launch_files.losses import Losses
    from play_launch.launch_files.records import Source, Unit


def origin_of(name: str) -> Origin:
    """Return the origin for the name of a launch file, which may be empty."""
    return Origin(Place(name))


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
