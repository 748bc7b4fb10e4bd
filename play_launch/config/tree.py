"""YAML as a tree in which every key and value has its location.

Scalars are those of the core schema of YAML 1.2. PyYAML on its own reads YAML 1.1, where `on` is
true, `010` is eight and `10:30` is 630; here those are a string, ten and a string.
"""

from __future__ import annotations

import base64
import binascii
import math
import re
from enum import Enum, auto
from typing import TYPE_CHECKING, TypeAlias

from msgspec import Struct

from play_launch.config.problems import excerpt, join_path

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from play_launch.config.problems import Location, Report

_STANDARD = "tag:yaml.org,2002:"
_NULL = frozenset({"", "~", "null", "Null", "NULL"})
_BOOL = {
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_INTEGER = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", re.ASCII)
_FLOAT = re.compile(
    r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
    re.ASCII,
)


class ScalarKind(Enum):
    """The type of a scalar; INVALID where a problem has been reported already."""

    NULL = auto()
    BOOL = auto()
    INTEGER = auto()
    FLOAT = auto()
    STRING = auto()
    BINARY = auto()
    INVALID = auto()


ScalarValue: TypeAlias = bool | int | float | str | bytes | None
_KIND_OF_TAG = {
    _STANDARD + "null": ScalarKind.NULL,
    _STANDARD + "bool": ScalarKind.BOOL,
    _STANDARD + "int": ScalarKind.INTEGER,
    _STANDARD + "float": ScalarKind.FLOAT,
}


def resolve_scalar(text: str, tag: str | None, *, plain: bool) -> tuple[ScalarKind, ScalarValue]:
    """Return kind and value of the scalar `text`; `plain` is whether it stands without quotes.

    Raises ValueError for unknown tags, and where text and tag do not go together.
    """
    if tag is None:
        return _resolve_plain(text) if plain else (ScalarKind.STRING, text)
    if tag == "!" or tag == _STANDARD + "str":
        return ScalarKind.STRING, text
    if tag == _STANDARD + "binary":
        return ScalarKind.BINARY, _decode_base64(text)
    expected = _KIND_OF_TAG.get(tag)
    if expected is None:
        raise ValueError(unknown_tag(tag))
    kind, value = _resolve_plain(text)
    if kind is expected:
        return kind, value
    if expected is ScalarKind.FLOAT and kind is ScalarKind.INTEGER:
        return ScalarKind.FLOAT, _to_float(text)
    raise ValueError(f"{excerpt(text)} does not go with the tag {shown_tag(tag)}")


def shown_tag(tag: str) -> str:
    if tag.startswith(_STANDARD):
        tag = "!!" + tag.removeprefix(_STANDARD)
    return excerpt(tag)[1:-1]


def unknown_tag(tag: str) -> str:
    return f"the tag {shown_tag(tag)} is not supported; write the value without it"


def _resolve_plain(text: str) -> tuple[ScalarKind, ScalarValue]:
    if text in _NULL:
        return ScalarKind.NULL, None
    if text in _BOOL:
        return ScalarKind.BOOL, _BOOL[text]
    if text[0] not in "+-.0123456789":
        return ScalarKind.STRING, text
    if _INTEGER.fullmatch(text):
        return ScalarKind.INTEGER, _to_int(text)
    if _FLOAT.fullmatch(text):
        return ScalarKind.FLOAT, _to_float(text)
    return ScalarKind.STRING, text


def _to_int(text: str) -> int:
    try:
        return int(text, 0 if text[:2] in {"0x", "0o"} else 10)
    except ValueError:  # Python refuses more than 4,300 decimal digits
        raise ValueError(f"a number of {len(text)} characters") from None


def _to_float(text: str) -> float:
    if text[-1] in "fFnN" and text[:2] != "0x":
        return float(text.replace(".", ""))
    try:
        number = float(int(text, 0)) if text[:2] in {"0x", "0o"} else float(text)
    except OverflowError:
        number = math.inf
    if math.isinf(number):
        raise ValueError(f"{excerpt(text)} is larger than any double; write .inf for infinity")
    return number


def _decode_base64(text: str) -> bytes:
    try:
        return base64.b64decode("".join(text.split()), validate=True)
    except (binascii.Error, ValueError):
        message = f"{excerpt(text)} is not base64, which the tag !!binary needs"
        raise ValueError(message) from None


class Scalar(Struct, frozen=True, eq=False):
    """A single value; `plain` is whether it stands without quotes and tag.

    `substituted` is whether its text comes from a substitution: where a string is expected, such a
    value is one, whatever it looks like.
    """

    location: Location
    kind: ScalarKind
    value: ScalarValue
    text: str
    plain: bool
    substituted: bool = False

    @property
    def is_quotable(self) -> bool:
        return self.kind in _NAMES


class Sequence(Struct, frozen=True, eq=False):
    """A list; `array_tag` is one of the tags for ROS arrays, such as `!string_array`."""

    location: Location
    items: tuple[Node, ...]
    array_tag: str | None = None


class Entry(Struct, frozen=True, eq=False):
    """One key of a mapping and its value."""

    key: str
    location: Location
    value: Node


class Mapping(Struct, frozen=True, eq=False):
    """A mapping with distinct keys, merge keys resolved; keys are the text they are written as."""

    location: Location
    by_key: dict[str, Entry]

    @property
    def entries(self) -> Collection[Entry]:
        return self.by_key.values()

    def value(self, key: str) -> Node | None:
        entry = self.by_key.get(key)
        return None if entry is None else entry.value


Node: TypeAlias = Scalar | Sequence | Mapping


def scalars_of(node: Node) -> Iterator[Scalar]:
    """Yield all values that stand in it."""
    if isinstance(node, Scalar):
        yield node
        return
    below = (each.value for each in node.entries) if isinstance(node, Mapping) else node.items
    for each in below:
        yield from scalars_of(each)


class Cursor(Struct, frozen=True):
    """A node, the path that leads to it, and the report for problems with it."""

    node: Node
    path: str
    report: Report

    @property
    def is_invalid(self) -> bool:
        """Whether a problem has been reported already, in place of a value."""
        return isinstance(self.node, Scalar) and self.node.kind is ScalarKind.INVALID

    @property
    def is_plain_list(self) -> bool:
        return isinstance(self.node, Sequence) and self.node.array_tag is None

    @property
    def string(self) -> str | None:
        """The text of a string, and of what was substituted; None for everything else."""
        node = self.node
        if not isinstance(node, Scalar) or node.kind is ScalarKind.INVALID:
            return None
        return node.text if node.kind is ScalarKind.STRING or node.substituted else None

    def problem(self, message: str, location: Location | None = None) -> None:
        self.report.add(location or self.node.location, self.path or "(top level)", message)

    def expected(self, what: str) -> None:
        """Report that something else stands here, unless a problem has been reported already."""
        if not self.is_invalid:
            self.problem(f"expected {what}, given {describe_node(self.node)}")

    def below(self, key: str, node: Node | None = None) -> Cursor:
        """Return `node` below `key`; without one, this node with that path."""
        return Cursor(node or self.node, join_path(self.path, key), self.report)

    def value(self, key: str) -> Cursor | None:
        """Return the value of `key`; None where this is no mapping, or has no such key."""
        found = self.node.value(key) if isinstance(self.node, Mapping) else None
        return None if found is None else self.below(key, found)

    def at_key(self, key: str) -> Cursor:
        """Return where a problem with `key` is reported, whether it is given or not."""
        return self.value(key) or self.below(key)

    def entries(self) -> Iterator[tuple[Entry, Cursor]]:
        if isinstance(self.node, Mapping):
            for entry in self.node.entries:
                yield entry, self.below(entry.key, entry.value)

    def elements(self) -> Iterator[Cursor]:
        if isinstance(self.node, Sequence):
            for index in range(len(self.node.items)):
                yield self.element(index)

    def element(self, index: int) -> Cursor:
        assert isinstance(self.node, Sequence)
        return Cursor(self.node.items[index], f"{self.path}[{index}]", self.report)


_NAMES = {
    ScalarKind.BOOL: "the boolean",
    ScalarKind.INTEGER: "the integer",
    ScalarKind.FLOAT: "the number",
}


def describe_node(node: Node) -> str:
    """Name what stands at `node`, for messages: `the integer 5`, `a list`."""
    if isinstance(node, Sequence):
        return "a list"
    if isinstance(node, Mapping):
        return "a mapping"
    if node.kind in _NAMES:
        return f"{_NAMES[node.kind]} {excerpt(node.text)[1:-1]}"
    if node.kind is ScalarKind.STRING:
        return f"the string {excerpt(node.text)}"
    return "binary data" if node.kind is ScalarKind.BINARY else "nothing"
