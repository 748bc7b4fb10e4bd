"""Read a configuration and the files that it includes, and merge them into one tree.

Mappings are merged key by key, lists of named entries by name; parameters of both files count, and
any other value in the including file replaces the included one.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.compose import Reading, Tally, compose
from play_launch.config.problems import KNOWN, Location, excerpt
from play_launch.config.source import Refused, decode, path_from
from play_launch.config.tree import Cursor, Entry, Mapping, Scalar, ScalarKind, Sequence

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from collections.abc import Mapping as Values
    from pathlib import Path

    from play_launch.config.problems import Report
    from play_launch.config.substitutions import InputsUsed
    from play_launch.config.tree import Node

DEEPEST_INCLUSION: Final = 20
"""Files that include one another, the first one not counted."""
_INCLUDE: Final = "include"
_LAUNCH_FILES: Final = (".py", ".xml")
_ENTRY: Final = "the path of a file, or {file: ..., arguments: {...}}"
_BY_NAME: Final = {
    "containers": "container",
    "composable_nodes": "composable node",
    "nodes": "node",
}
_ACCUMULATED: Final = frozenset({"parameters", "process_parameters", "extra_arguments"})


class _File(Struct, frozen=True):
    """A file that is being read, its inclusion and its arguments."""

    path: Path
    content: bytes
    arguments: Values[str, str]
    included_from: Location | None = None
    ancestors: tuple[str, ...] = ()
    """Real paths of the files that include it, from the first one on, itself not among them."""
    machine: Cursor | None = None
    """For its entries that name none."""


class Documents:
    """The files of one configuration."""

    def __init__(
        self, report: Report, read: Callable[[Path], bytes | Refused], used: InputsUsed
    ) -> None:
        self._report = report
        self._read_bytes = read
        self._used = used
        self._tally = Tally()
        self._arguments: list[tuple[str, Cursor]] = []
        """The arguments of inclusions."""
        self.included: dict[Path, bytes] = {}
        """The files that were included, in the order in which they were read."""

    def read(self, content: bytes, source: Path) -> Node | None:
        """Return the tree of a configuration; None after every reason was reported."""
        root = self._read(_File(source, content, self._used.arguments))
        if root is None:
            return None
        known = self._used.known_arguments
        fix = "the configuration reads no arguments"
        if known:
            fix = f"known arguments: {', '.join(sorted(known))}"
        for name in self._used.arguments.keys() - known:
            message = f"nothing reads the argument {name}; {fix}"
            self._report.add(Location(str(source), 1, 1), "(arguments)", message)
        for name, at in self._arguments:
            if name not in known:
                at.problem(f"nothing reads the argument {name}; {fix}")
        return root

    def _read(self, file: _File) -> Node | None:
        name = str(file.path)
        text = decode(file.content, name)
        if isinstance(text, Refused):
            location = replace(text.location, included_from=file.included_from)
            self._report.add(location, "(file)", text.message)
            return None
        before = len(self._report)
        substitute = self._used.substitutions(file.arguments)
        reading = Reading(file.included_from, substitute, self._tally)
        root = compose(text, name, self._report, reading)
        if root is None or (isinstance(root, Scalar) and root.kind is ScalarKind.NULL):
            if len(self._report) == before:
                start = Location(name, 1, 1, file.included_from)
                message = "holds no configuration; begin with version: 1"
                self._report.add(start if root is None else root.location, "(file)", message)
            return None
        at = Cursor(root, "", self._report)
        includes = at.value(_INCLUDE)
        if file.included_from is not None or includes is not None:
            _check_version(at)
        if includes is None or not isinstance(root, Mapping):
            return root
        base = Mapping(root.location, {})
        for inclusion in self._inclusions_in(includes, file):
            included = self._read(inclusion)
            if isinstance(included, Mapping):
                if inclusion.machine is not None:
                    included = _on_machine(included, inclusion.machine.node)
                base = merge(base, Cursor(included, "", self._report))
            elif included is not None:
                Cursor(included, "", self._report).expected("a configuration")
        return merge(base, at)

    def _inclusions_in(self, includes: Cursor, file: _File) -> Iterator[_File]:
        is_list = isinstance(includes.node, Sequence)
        for entry in includes.elements() if is_list else (includes,):
            arguments: dict[str, str] = {}
            machine: Cursor | None = None
            at_file: Cursor | None = entry
            if isinstance(entry.node, Mapping):
                at_file = entry.value("file")
                machine = entry.value("machine")
                given = _arguments(entry)
                if any(at.is_invalid for at in given.values()):
                    continue  # what follows from that would be reported as well
                self._arguments += given.items()
                arguments = {
                    name: at.node.text for name, at in given.items() if isinstance(at.node, Scalar)
                }
            if at_file is None or not at_file.string:
                (at_file or entry).expected(_ENTRY)
                continue
            if at_file.node.location in self._report.missing_packages:
                continue
            path = path_from(at_file, at_file.string)
            ancestors = (*file.ancestors, os.path.realpath(file.path))
            content = self._content(at_file, path, ancestors)
            if content is not None:
                arguments = {**file.arguments, **arguments}
                location = at_file.node.location
                yield _File(path, content, arguments, location, ancestors, machine)

    def _content(self, at: Cursor, path: Path, ancestors: tuple[str, ...]) -> bytes | None:
        problem = ""
        if os.path.realpath(path) in ancestors:
            problem = f"{path} includes itself this way; leave one of the inclusions out"
        elif len(ancestors) > DEEPEST_INCLUSION:
            problem = f"files include one another deeper than {DEEPEST_INCLUSION} levels"
        elif path.suffix in _LAUNCH_FILES:
            problem = f"{path} is a launch file; include takes configurations like this one"
        elif path not in self.included:
            found = self._read_bytes(path)
            if isinstance(found, Refused):
                problem = f"the included file {path}: {found.message}"
            else:
                self.included[path] = found
        if problem:
            at.problem(problem)
            return None
        return self.included[path]


def _arguments(entry: Cursor) -> dict[str, Cursor]:
    for key, value in entry.entries():
        if key.key not in {"file", "arguments", "machine"}:
            message = f"unknown key {excerpt(key.key)}{KNOWN}file, arguments, machine"
            value.problem(message, key.location)
    at = entry.value("arguments")
    if at is None:
        return {}
    if not isinstance(at.node, Mapping):
        at.expected("a mapping of arguments to values")
    arguments: dict[str, Cursor] = {}
    for key, value in at.entries():
        if isinstance(value.node, Scalar):
            arguments[key.key] = value
        else:
            value.expected("a value")
    return arguments


def _on_machine(document: Mapping, machine: Node) -> Mapping:
    """Return a document in which every container and node has a machine."""
    by_key = dict(document.by_key)
    for key in ("containers", "nodes"):
        entry = by_key.get(key)
        if entry is not None and isinstance(entry.value, Sequence):
            default = {"machine": Entry("machine", machine.location, machine)}
            items = tuple(
                Mapping(item.location, {**default, **item.by_key})
                if isinstance(item, Mapping)
                else item
                for item in entry.value.items
            )
            by_key[key] = Entry(key, entry.location, Sequence(entry.value.location, items))
    return Mapping(document.location, by_key)


def _check_version(at: Cursor) -> None:
    if not isinstance(at.node, Mapping):
        return
    version = at.value("version")
    if version is None:
        at.problem('the key "version" is missing')
    elif not (isinstance(version.node, Scalar) and version.node.value == 1):
        version.expected("version 1")


def merge(base: Mapping, over: Cursor) -> Mapping:
    """Return a document, or an entry of a list, merged over an included one; report mistakes."""
    assert isinstance(over.node, Mapping)
    merged = _key_by_key(base, over)
    merged.pop(_INCLUDE, None)
    # An entry is where it is declared first, the document is the file that was given.
    location = base.location if base.by_key and over.path else over.node.location
    return Mapping(location, merged)


def _key_by_key(base: Mapping, over: Cursor) -> dict[str, Entry]:
    merged = dict(base.by_key)
    for entry, value in over.entries():
        node = _merged(entry.key, base.value(entry.key), value)
        merged[entry.key] = Entry(entry.key, entry.location, node)
    return merged


def _merged(key: str, before: Node | None, over: Cursor) -> Node:
    if key in _BY_NAME and isinstance(over.node, Sequence):
        included = before if isinstance(before, Sequence) else Sequence(over.node.location, ())
        return _merged_entries(_BY_NAME[key], included, over)
    if key in _ACCUMULATED and before is not None:
        items: list[Node] = []
        for node in (before, over.node):
            is_list = isinstance(node, Sequence) and node.array_tag is None
            items += node.items if is_list and isinstance(node, Sequence) else (node,)
        return Sequence(over.node.location, tuple(items))
    if isinstance(before, Mapping) and isinstance(over.node, Mapping):
        return Mapping(over.node.location, _key_by_key(before, over))
    return over.node


def _merged_entries(what: str, included: Sequence, over: Cursor) -> Sequence:
    entries: list[Node] = list(included.items)
    merged: set[int] = set()
    for item in over.elements():
        if not isinstance(item.node, Mapping):
            entries.append(item.node)
            continue
        candidates = [
            number for number in _named_alike(item.node, included) if number not in merged
        ]
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
            entries.append(merge(Mapping(item.node.location, {}), item))
        merged.update(candidates)
    return Sequence(over.node.location, tuple(entries))


def _named_alike(entry: Mapping, included: Sequence) -> list[int]:
    """Return the numbers of the included entries that the entry may mean.

    Its namespace is compared only if it gives one.
    """
    name, namespace = _text(entry, "name"), _text(entry, "namespace")
    return [
        number
        for number, node in enumerate(included.items)
        if name
        and isinstance(node, Mapping)
        and _text(node, "name") == name
        and (
            namespace is None or namespace.strip("/") == (_text(node, "namespace") or "").strip("/")
        )
    ]


def _text(mapping: Mapping, key: str) -> str | None:
    node = mapping.value(key)
    return node.text if isinstance(node, Scalar) else None
