"""Remappings in the forms that people know from launch files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from play_launch.config.problems import excerpt
from play_launch.config.values import check_topic
from play_launch.config.yaml.tree import Mapping, Sequence, describe_node

if TYPE_CHECKING:
    from play_launch.config.problems import Place, Report
    from play_launch.config.yaml.tree import At, Node

_FORMS = 'expected a remapping such as "chatter:=/sensing/chatter" or {from: chatter, to: /chatter}'
_SPECIAL = {"__node": "name", "__name": "name", "__ns": "namespace"}


def resolve_remappings(at: At | None) -> tuple[tuple[str, str], ...]:
    """Return the (from, to) pairs that stand there, in their order.

    Taken are a mapping `{from: to}`, and a list of `from:=to`, `[from, to]` or
    `{from: ..., to: ...}`.
    """
    if at is None:
        return ()
    collected = _Collected(at.report)
    if isinstance(at.node, Mapping):
        for entry, value in at.entries():
            target = _string(value)
            if target is not None:
                collected.add(value, (entry.key, entry.place), (target, entry.value.place))
    elif isinstance(at.node, Sequence) and at.node.array_tag is None:
        for item in at.elements():
            _add_item(item, collected)
    elif not at.is_invalid:
        at.problem(f"{_FORMS}, in a list, given {describe_node(at.node)}")
    return tuple(collected.pairs)


class _Collected:
    def __init__(self, report: Report) -> None:
        self.pairs: list[tuple[str, str]] = []
        self._report = report
        self._places: dict[str, Place] = {}

    def add(self, at: At, source: tuple[str, Place], target: tuple[str, Place]) -> None:
        before = len(self._report)
        name, place = source
        if name in _SPECIAL:
            at.problem(f"{name} cannot be remapped here; use the key {_SPECIAL[name]}", place)
            return
        for side, side_place in (source, target):
            try:
                check_topic(side)
            except ValueError as error:
                at.problem(str(error), side_place)
        if name in self._places:
            first = self._places[name]
            at.problem(f"{excerpt(name)} is remapped twice, first at {first}", place)
        self._places.setdefault(name, place)
        if len(self._report) == before:
            self.pairs.append((name, target[0]))


def _add_item(at: At, collected: _Collected) -> None:
    item = at.node
    sides: tuple[Node, ...] = ()
    if isinstance(item, Mapping) and item.by_key.keys() == {"from", "to"}:
        sides = (item.by_key["from"].value, item.by_key["to"].value)
    elif isinstance(item, Sequence) and item.array_tag is None and len(item.items) == 2:
        sides = item.items
    if not sides:
        source, separator, target = (at.string or "").partition(":=")
        if separator:
            collected.add(at, (source.strip(), item.place), (target.strip(), item.place))
        elif not at.is_invalid:
            at.problem(f"{_FORMS}, given {describe_node(item)}")
        return
    names = [_string(replace(at, node=side)) for side in sides]
    if names[0] is not None and names[1] is not None:
        collected.add(at, (names[0], sides[0].place), (names[1], sides[1].place))


def _string(at: At) -> str | None:
    if at.string is None:
        at.expected("a topic or service name")
    return at.string
