"""YAML as a tree in which every key and value knows its place."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from msgspec import Struct

from play_launch.config.problems import excerpt, join_path
from play_launch.config.yaml.scalars import ScalarKind

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from play_launch.config.problems import Place, Report
    from play_launch.config.yaml.scalars import ScalarValue


class Scalar(Struct, frozen=True, eq=False):
    """A single value; `plain` is whether it stands without quotes and tag.

    `substituted` is whether its text comes from a substitution: where a string is expected, such a
    value is one, whatever it looks like.
    """

    place: Place
    kind: ScalarKind
    value: ScalarValue
    text: str
    plain: bool
    substituted: bool = False


class Sequence(Struct, frozen=True, eq=False):
    """A list; `array_tag` is one of the tags for ROS arrays, such as `!string_array`."""

    place: Place
    items: tuple[Node, ...]
    array_tag: str | None = None


class Entry(Struct, frozen=True, eq=False):
    """One key of a mapping and its value."""

    key: str
    place: Place
    value: Node


class Mapping(Struct, frozen=True, eq=False):
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


class At(Struct, frozen=True):
    """A node, the path that leads to it, and the report for what is wrong with it."""

    node: Node
    path: str
    report: Report

    @property
    def is_invalid(self) -> bool:
        """Whether a problem has been reported already, in place of a value."""
        return isinstance(self.node, Scalar) and self.node.kind is ScalarKind.INVALID

    @property
    def string(self) -> str | None:
        """The text of a string, and of what was substituted; None for everything else."""
        node = self.node
        if not isinstance(node, Scalar) or node.kind is ScalarKind.INVALID:
            return None
        return node.text if node.kind is ScalarKind.STRING or node.substituted else None

    def problem(self, message: str, place: Place | None = None) -> None:
        """Report `message`, at `place` or where the node stands."""
        self.report.add(place or self.node.place, self.path or "(top level)", message)

    def expected(self, what: str) -> None:
        """Report that something else stands here, unless a problem has been reported already."""
        if not self.is_invalid:
            self.problem(f"expected {what}, given {describe_node(self.node)}")

    def below(self, key: str, node: Node | None = None) -> At:
        """Return what stands below `key`: `node`, or this node where there is no such key."""
        return At(node or self.node, join_path(self.path, key), self.report)

    def value(self, key: str) -> At | None:
        """Return the value of `key`; None where this is no mapping, or has no such key."""
        found = self.node.value(key) if isinstance(self.node, Mapping) else None
        return None if found is None else self.below(key, found)

    def blame(self, key: str) -> At:
        """Return where a problem with `key` is reported, whether it is there or not."""
        return self.value(key) or self.below(key)

    def entries(self) -> Iterator[tuple[Entry, At]]:
        """Yield the entries of a mapping with their values."""
        if isinstance(self.node, Mapping):
            for entry in self.node.entries:
                yield entry, self.below(entry.key, entry.value)

    def elements(self) -> Iterator[At]:
        """Yield the elements of a list."""
        if isinstance(self.node, Sequence):
            for index in range(len(self.node.items)):
                yield self.element(index)

    def element(self, index: int) -> At:
        """Return an element of a list."""
        assert isinstance(self.node, Sequence)
        return At(self.node.items[index], f"{self.path}[{index}]", self.report)


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
