"""Remappings in the forms that people know from launch files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.names import check_topic
from play_launch.config.problems import Place, excerpt, join_path
from play_launch.config.yaml_scalars import ScalarKind
from play_launch.config.yaml_tree import Mapping, Node, Scalar, Sequence, describe_node

if TYPE_CHECKING:
    from play_launch.config.report import Report

_FORMS = 'expected a remapping such as "chatter:=/sensing/chatter" or {from: chatter, to: /chatter}'
_SPECIAL = {"__node": "name", "__name": "name", "__ns": "namespace"}


def resolve_remappings(node: Node | None, path: str, report: Report) -> tuple[tuple[str, str], ...]:
    """Return the (from, to) pairs at `node` in their order.

    Taken are a mapping `{from: to}`, and a list of `from:=to`, `[from, to]` or
    `{from: ..., to: ...}`.
    """
    if node is None:
        return ()
    collected = _Collected(report)
    if isinstance(node, Mapping):
        for entry in node.entries:
            where = join_path(path, entry.key)
            target = _string(entry.value, where, report)
            if target is not None:
                collected.add(entry.key, entry.place, target, entry.value.place, where)
    elif isinstance(node, Sequence) and node.array_tag is None:
        for index, item in enumerate(node.items):
            _add_item(item, f"{path}[{index}]", collected)
    elif not (isinstance(node, Scalar) and node.kind is ScalarKind.INVALID):
        report.add(node.place, path, f"{_FORMS}, in a list, given {describe_node(node)}")
    return tuple(collected.pairs)


class _Collected:
    def __init__(self, report: Report) -> None:
        self.pairs: list[tuple[str, str]] = []
        self.report = report
        self._places: dict[str, Place] = {}

    def add(self, source: str, source_at: Place, target: str, target_at: Place, path: str) -> None:
        before = len(self.report)
        if source in _SPECIAL:
            message = f"{source} cannot be remapped here; use the key {_SPECIAL[source]}"
            self.report.add(source_at, path, message)
            return
        for name, place in ((source, source_at), (target, target_at)):
            try:
                check_topic(name)
            except ValueError as error:
                self.report.add(place, path, str(error))
        if source in self._places:
            message = f"{excerpt(source)} is remapped twice, first at {self._places[source]}"
            self.report.add(source_at, path, message)
        self._places.setdefault(source, source_at)
        if len(self.report) == before:
            self.pairs.append((source, target))


def _add_item(item: Node, path: str, collected: _Collected) -> None:
    report = collected.report
    sides: list[Node] | None = None
    if isinstance(item, Mapping) and {entry.key for entry in item.entries} == {"from", "to"}:
        by_key = {entry.key: entry.value for entry in item.entries}
        sides = [by_key["from"], by_key["to"]]
    elif isinstance(item, Sequence) and item.array_tag is None and len(item.items) == 2:
        sides = list(item.items)
    elif isinstance(item, Scalar) and item.kind is ScalarKind.STRING:
        source, separator, target = item.text.partition(":=")
        if separator:
            collected.add(source.strip(), item.place, target.strip(), item.place, path)
        else:
            report.add(item.place, path, f"{_FORMS}, given {describe_node(item)}")
        return
    if sides is None:
        if not (isinstance(item, Scalar) and item.kind is ScalarKind.INVALID):
            report.add(item.place, path, f"{_FORMS}, given {describe_node(item)}")
        return
    source_node, target_node = sides
    source_text = _string(source_node, path, report)
    target_text = _string(target_node, path, report)
    if source_text is not None and target_text is not None:
        collected.add(source_text, source_node.place, target_text, target_node.place, path)


def _string(node: Node, path: str, report: Report) -> str | None:
    if isinstance(node, Scalar) and node.kind is ScalarKind.STRING:
        return node.text
    if not (isinstance(node, Scalar) and node.kind is ScalarKind.INVALID):
        report.add(
            node.place, path, f"expected a topic or service name, given {describe_node(node)}"
        )
    return None
