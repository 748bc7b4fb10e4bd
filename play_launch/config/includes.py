"""Read a configuration and the files that it includes, and merge them into one tree."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.compose import Reading, Tally, compose
from play_launch.config.problems import Place, excerpt
from play_launch.config.source import Refused, decode, path_from
from play_launch.config.substitutions import Given
from play_launch.config.tree import At, Entry, Mapping, Scalar, ScalarKind, Sequence

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from collections.abc import Mapping as Values
    from pathlib import Path

    from play_launch.config.problems import Report
    from play_launch.config.substitutions import Taken
    from play_launch.config.tree import Node


DEEPEST_INCLUSION: Final = 20
"""Files that include one another, the first one not counted."""
MOST_INCLUSIONS: Final = 200
"""Inclusions in one configuration; a file that is included twice counts twice."""
_LAUNCH_FILES: Final = (".py", ".xml")
_ENTRY: Final = "the path of a file, or {file: ..., arguments: {...}}"


class _File(Struct, frozen=True):
    """A file that is being read, its inclusion and its arguments."""

    path: Path
    content: bytes
    arguments: Values[str, Given]
    included_from: Place | None
    ancestors: tuple[str, ...]
    """Real paths of the files that include it, from the first one on, itself not among them."""


class Documents:
    """The files of one configuration."""

    def __init__(
        self, report: Report, read: Callable[[Path], bytes | Refused], taken: Taken
    ) -> None:
        self._report = report
        self._read_bytes = read
        self._taken = taken
        self._tally = Tally()
        self._inclusions = 0
        self.included: dict[Path, bytes] = {}
        """The files that were included, in the order in which they were read."""

    def read(self, content: bytes, source: Path) -> Node | None:
        """Return the tree of a configuration; None after every reason was reported."""
        arguments = {name: Given(value) for name, value in self._taken.arguments.items()}
        file = _File(source, content, arguments, None, ())
        root = self._read(file)
        if root is not None:
            self._refuse_unread(file, {})
        return root

    def _read(self, file: _File) -> Node | None:
        name = str(file.path)
        start = Place(name, 1, 1, file.included_from)
        text = decode(file.content, name)
        if isinstance(text, Refused):
            place = replace(text.place, included_from=file.included_from)
            self._report.add(place, "(file)", text.message)
            return None
        before = len(self._report)
        substitute = self._taken.substitutions(file.arguments)
        reading = Reading(file.included_from, substitute, self._tally)
        root = compose(text, name, self._report, reading)
        if root is None or has_nothing(root):
            if len(self._report) == before:
                place = start if root is None else root.place
                self._report.add(place, "(file)", "holds no configuration; begin with version: 1")
            return None
        return self._with_included(root, file)

    def _with_included(self, root: Node, file: _File) -> Node:
        at = At(root, "", self._report)
        includes = at.value(INCLUDE)
        if file.included_from is not None or includes is not None:
            _check_version(at)
        if includes is None or not isinstance(root, Mapping):
            return root
        base = Mapping(root.place, {})
        for inclusion in self._inclusions_in(includes, file):
            included = self._read(inclusion)
            self._refuse_unread(inclusion, file.arguments)
            if isinstance(included, Mapping):
                base = merge(base, At(included, "", self._report))
            elif included is not None:
                At(included, "", self._report).expected("a configuration")
        return merge(base, at)

    def _inclusions_in(self, includes: At, file: _File) -> Iterator[_File]:
        is_list = isinstance(includes.node, Sequence)
        for entry in includes.elements() if is_list else (includes,):
            arguments: dict[str, Given] = {}
            at_file: At | None = entry
            if isinstance(entry.node, Mapping):
                at_file = entry.value("file")
                arguments = _arguments(entry)
            if any(given.at and given.at.is_invalid for given in arguments.values()):
                continue  # what follows from that would be reported as well
            if at_file is None or not at_file.string:
                (at_file or entry).expected(_ENTRY)
                continue
            path = path_from(at_file, at_file.string)
            inclusion = self._open(at_file, path, file, {**file.arguments, **arguments})
            if inclusion is not None:
                yield inclusion

    def _open(self, at: At, path: Path, file: _File, arguments: Values[str, Given]) -> _File | None:
        ancestors = (*file.ancestors, os.path.realpath(file.path))
        self._inclusions += 1
        if os.path.realpath(path) in ancestors:
            at.problem(f"{path} includes itself this way; leave one of the inclusions out")
            return None
        if len(ancestors) > DEEPEST_INCLUSION:
            at.problem(f"files include one another deeper than {DEEPEST_INCLUSION} levels")
            return None
        if self._inclusions > MOST_INCLUSIONS:
            at.problem(f"more than {MOST_INCLUSIONS} inclusions in one configuration")
            return None
        if path.suffix in _LAUNCH_FILES:
            at.problem(f"{path} is a launch file; include takes configurations like this one")
            return None
        content = self.included.get(path)
        if content is None:
            found = self._read_bytes(path)
            if isinstance(found, Refused):
                at.problem(f"the included file {path}: {found.message}")
                return None
            content = self.included[path] = found
        return _File(path, content, arguments, at.node.place, ancestors)

    def _refuse_unread(self, file: _File, outer: Values[str, Given]) -> None:
        """Report arguments of a file that nothing reads; `outer` are those of the including one."""
        known = ", ".join(sorted(self._taken.known_arguments))
        fix = f"known arguments: {known}" if known else "the configuration reads no arguments"
        for name, given in file.arguments.items():
            if given.is_read or given is outer.get(name):
                continue
            message = f"nothing reads the argument {name}; {fix}"
            if given.at is None:
                self._report.add(Place(str(file.path), 1, 1), "(arguments)", message)
            else:
                given.at.problem(message)


def _arguments(entry: At) -> dict[str, Given]:
    """Return the arguments of an inclusion; report other values."""
    for key, value in entry.entries():
        if key.key not in {"file", "arguments"}:
            value.problem(f"unknown key {excerpt(key.key)}; known here: file, arguments", key.place)
    at = entry.value("arguments")
    if at is None:
        return {}
    if not isinstance(at.node, Mapping):
        at.expected("a mapping of arguments to values")
    arguments: dict[str, Given] = {}
    for key, value in at.entries():
        if isinstance(value.node, Scalar):
            arguments[key.key] = Given(value.node.text, value)
        else:
            value.expected("a value")
    return arguments


def _check_version(at: At) -> None:
    if not isinstance(at.node, Mapping):
        return
    version = at.value("version")
    if version is None:
        at.problem('the key "version" is missing')
    elif not (isinstance(version.node, Scalar) and version.node.value == 1):
        version.expected("version 1")


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
