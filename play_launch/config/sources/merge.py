"""Merge a configuration over the ones that it includes.

Mappings are merged key by key; containers and nodes by their names; parameters become further
sources. Everything else of the including file replaces what was included.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from play_launch.config.problems import excerpt
from play_launch.config.yaml.scalars import ScalarKind
from play_launch.config.yaml.tree import At, Entry, Mapping, Scalar, Sequence

if TYPE_CHECKING:
    from play_launch.config.yaml.tree import Node

INCLUDE: Final = "include"
_BY_NAME: Final = {
    "containers": "container",
    "composable_nodes": "composable node",
    "nodes": "node",
}
_SOURCES: Final = frozenset({"parameters", "process_parameters", "extra_arguments"})


def merge(base: Mapping, over: At) -> Mapping:
    """Return a document, or an entry of a list, merged over an included one; report mistakes."""
    assert isinstance(over.node, Mapping)
    merged = _key_by_key(base, over)
    merged.pop(INCLUDE, None)
    # An entry is where it is declared first, the document is the file that was given.
    place = base.place if base.by_key and over.path else over.node.place
    return Mapping(place, merged)


def _key_by_key(base: Mapping, over: At) -> dict[str, Entry]:
    merged = dict(base.by_key)
    for entry, value in over.entries():
        node = _merged(entry.key, base.value(entry.key), value)
        merged[entry.key] = Entry(entry.key, entry.place, node)
    return merged


def _merged(key: str, before: Node | None, over: At) -> Node:
    if key in _BY_NAME and isinstance(over.node, Sequence):
        included = before if isinstance(before, Sequence) else Sequence(over.node.place, ())
        return _merged_entries(_BY_NAME[key], included, over)
    if key in _SOURCES and before is not None:
        return _further_sources(before, over.node)
    if isinstance(before, Mapping) and isinstance(over.node, Mapping):
        return Mapping(over.node.place, _key_by_key(before, over))
    return over.node


def _further_sources(before: Node, over: Node) -> Node:
    """Return the sources of both; of a mapping that is repeated key by key, the later wins."""
    items: list[Node] = []
    for node in (before, over):
        is_list = isinstance(node, Sequence) and node.array_tag is None
        items += node.items if is_list and isinstance(node, Sequence) else (node,)
    return Sequence(over.place, tuple(items))


def _merged_entries(what: str, included: Sequence, over: At) -> Sequence:
    entries: list[Node] = list(included.items)
    taken: set[int] = set()
    for item in over.elements():
        if not isinstance(item.node, Mapping):
            entries.append(item.node)
            continue
        candidates = [number for number in _named_alike(item, included) if number not in taken]
        if len(candidates) > 1:
            name = excerpt(_text(item.node, "name") or "")
            item.problem(
                f"{len(candidates)} included {what}s are called {name}; give the namespace too"
            )
        elif candidates:
            (number,) = candidates
            base = included.items[number]
            assert isinstance(base, Mapping)
            entries[number] = merge(base, item)
        else:
            entries.append(merge(Mapping(item.node.place, {}), item))
        taken.update(candidates)
    return Sequence(over.node.place, tuple(entries))


def _named_alike(item: At, included: Sequence) -> list[int]:
    """Return the numbers of the included entries that the entry may mean.

    Its namespace is compared only if it gives one.
    """
    assert isinstance(item.node, Mapping)
    name, namespace = _text(item.node, "name"), _text(item.node, "namespace")
    if not name:
        return []
    return [
        number
        for number, node in enumerate(included.items)
        if isinstance(node, Mapping)
        and _text(node, "name") == name
        and (namespace is None or _absolute(namespace) == _absolute(_text(node, "namespace")))
    ]


def _absolute(namespace: str | None) -> str:
    return "/" + (namespace or "").strip("/")


def _text(mapping: Mapping, key: str) -> str | None:
    node = mapping.value(key)
    return node.text if isinstance(node, Scalar) else None


def has_nothing(node: Node) -> bool:
    """Whether the node is the null of an empty file."""
    return isinstance(node, Scalar) and node.kind is ScalarKind.NULL
