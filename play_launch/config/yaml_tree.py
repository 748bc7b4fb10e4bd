"""YAML as a tree in which every key and value knows its place.

The tree is put together from the parser's events rather than by PyYAML's composer: that one
recurses in C (deep nesting ends the process), keeps the last of two equal keys, and follows
aliases without counting.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from play_launch.config.problems import excerpt
from play_launch.config.yaml_scalars import ScalarKind

if TYPE_CHECKING:
    from collections.abc import Collection

    from play_launch.config.problems import Place
    from play_launch.config.yaml_scalars import ScalarValue


@dataclass(frozen=True, slots=True, eq=False)
class Scalar:
    """A single value; `plain` is whether it stands without quotes and tag."""

    place: Place
    kind: ScalarKind
    value: ScalarValue
    text: str
    plain: bool


@dataclass(frozen=True, slots=True, eq=False)
class Sequence:
    """A list; `array_tag` is one of the tags for ROS arrays, such as `!string_array`."""

    place: Place
    items: tuple[Node, ...]
    array_tag: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """One key of a mapping and its value."""

    key: str
    place: Place
    value: Node


@dataclass(frozen=True, slots=True, eq=False)
class Mapping:
    """A mapping with distinct keys, merge keys resolved; keys are the text they are written as."""

    place: Place
    by_key: dict[str, Entry]

    @property
    def entries(self) -> Collection[Entry]:
        """The entries in the order of the file."""
        return self.by_key.values()

    def entry(self, key: str) -> Entry | None:
        """Return the entry called `key`."""
        return self.by_key.get(key)

    def value(self, key: str) -> Node | None:
        """Return the value of `key`."""
        entry = self.entry(key)
        return None if entry is None else entry.value


Node: TypeAlias = Scalar | Sequence | Mapping


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


_NAMES = {
    ScalarKind.BOOL: "the boolean",
    ScalarKind.INTEGER: "the integer",
    ScalarKind.FLOAT: "the number",
}
