"""What becomes of a configuration that includes others: its tree over theirs.

Mappings are merged key by key; containers and nodes by their names; parameters become further
sources. Everything else of the including file takes the place of what was included. A key `remove`
takes an entry out, or some of its keys; nothing of it is left afterwards.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from play_launch.config.problems import excerpt
from play_launch.config.yaml.scalars import ScalarKind
from play_launch.config.yaml.tree import At, Entry, Mapping, Scalar, Sequence

if TYPE_CHECKING:
    from collections.abc import Container, Iterable

    from play_launch.config.yaml.tree import Node

REMOVE: Final = "remove"
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
    base = _without_removed(base, over)
    merged = _key_by_key(base, over, dropped={REMOVE, INCLUDE})
    # An entry is where it is declared first, the file as a whole is the one that was given.
    place = base.place if base.by_key and over.path else over.node.place
    return Mapping(place, merged)


def _key_by_key(base: Mapping, over: At, *, dropped: Container[str] = ()) -> dict[str, Entry]:
    merged = dict(base.by_key)
    for entry, value in over.entries():
        if entry.key not in dropped:
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
    entries: list[Node | None] = list(included.items)
    taken: set[int] = set()
    for item in over.elements():
        if not isinstance(item.node, Mapping):
            entries.append(item.node)
            continue
        candidates = [number for number in _named_alike(item, included) if number not in taken]
        if _is_removed(item):
            if len(candidates) == 1:
                entries[candidates[0]] = None
                _refuse_more(item)
            else:
                item.problem(f"nothing to remove: {_why_not(what, item, len(candidates))}")
        elif len(candidates) > 1:
            item.problem(_why_not(what, item, len(candidates)))
        elif candidates:
            (number,) = candidates
            base = included.items[number]
            assert isinstance(base, Mapping)
            entries[number] = merge(base, item)
        else:
            entries.append(merge(Mapping(item.node.place, {}), item))
        taken.update(candidates)
    left = [entry for entry in entries if entry is not None]
    return Sequence(over.node.place, tuple(left), labels=tuple(_labels(left)))


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


def _why_not(what: str, item: At, found: int) -> str:
    assert isinstance(item.node, Mapping)
    name = _text(item.node, "name")
    if name is None:
        return "give the name of the entry"
    if found:
        return f"{found} included entries are called {excerpt(name)}; give the namespace too"
    return f"no included file has a {what} called {excerpt(name)}"


def _refuse_more(item: At) -> None:
    for entry, value in item.entries():
        if entry.key not in {"name", "namespace", REMOVE}:
            value.problem("nothing reads this beside remove: true", entry.place)


def _is_removed(item: At) -> bool:
    value = item.value(REMOVE)
    return value is not None and isinstance(value.node, Scalar) and value.node.value is True


def _without_removed(base: Mapping, over: At) -> Mapping:
    """Take out of `base` what the key `remove` lists."""
    value = over.value(REMOVE)
    if value is None:
        return base
    if not isinstance(value.node, Sequence):
        value.expected("a list of keys such as [environment.DEBUG, duration]")
        return base
    for key in value.elements():
        text = key.string
        if text is None:
            key.expected("a key")
            continue
        without = _without(base, text.split("."))
        if without is None:
            key.problem(f"nothing to remove: no included file gives {excerpt(text)} here")
        else:
            base = without
    return base


def _without(mapping: Mapping, path: list[str]) -> Mapping | None:
    """Return the mapping without what the path leads to; None where it leads to nothing."""
    for length in range(1, len(path) + 1):
        # The name of a variable or parameter may hold dots itself.
        key, rest = ".".join(path[:length]), path[length:]
        entry = mapping.entry(key)
        if entry is None:
            continue
        left = dict(mapping.by_key)
        if not rest:
            del left[key]
            return replace(mapping, by_key=left)
        below = _without(entry.value, rest) if isinstance(entry.value, Mapping) else None
        if below is not None:
            left[key] = Entry(key, entry.place, below)
            return replace(mapping, by_key=left)
    return None


def _labels(entries: Iterable[Node]) -> Iterable[str]:
    for number, entry in enumerate(entries):
        name = _text(entry, "name") if isinstance(entry, Mapping) else None
        yield name or str(number)


def has_nothing(node: Node) -> bool:
    """Whether the node is the null of an empty file."""
    return isinstance(node, Scalar) and node.kind is ScalarKind.NULL
