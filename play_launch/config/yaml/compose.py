"""Puts the tree of a YAML text together, within bounds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NoReturn

import yaml

from play_launch.config.problems import Place, excerpt, join_path
from play_launch.config.yaml.scalars import (
    ScalarKind,
    ScalarRefusedError,
    resolve_scalar,
    shown_tag,
    unknown_tag,
)
from play_launch.config.yaml.syntax import explain, refused_directive
from play_launch.config.yaml.tree import Entry, Mapping, Node, Scalar, Sequence

if TYPE_CHECKING:
    from play_launch.config.problems import Report

MOST_VALUES = 200_000
"""Keys and values in one file, aliases counted as if their text stood there."""
DEEPEST = 100
"""Levels of mappings and lists in one another."""
ARRAY_TAGS = frozenset(
    {"!bool_array", "!integer_array", "!double_array", "!string_array", "!byte_array"}
)

_PLAIN_COLLECTION_TAGS = {
    yaml.SequenceStartEvent: frozenset({None, "!", "tag:yaml.org,2002:seq"}),
    yaml.MappingStartEvent: frozenset({None, "!", "tag:yaml.org,2002:map"}),
}
_NO_VALUE = (
    "no value is given (null); remove the key, "
    'or write "" for an empty string, [] for an empty list, {} for an empty mapping'
)
# libyaml does not come with every build of PyYAML; the parser in Python is slower, not different.
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def compose(text: str, file: str, report: Report) -> Node | None:
    """Return the tree of the only document in `text`, or None where there is none to speak of.

    Problems go to `report`: what is wrong with the syntax ends the reading, a key given twice
    or a tag of no use does not.
    """
    directive = refused_directive(text, file)
    if directive is not None:
        report.add(directive[0], "(yaml)", directive[1])
        return None
    try:
        return _Composer(file, report).run(text)
    except _StopReadingError as stop:
        report.add(stop.place, stop.path, stop.message)
    except yaml.YAMLError as error:
        place, message = explain(error, text, file)
        report.add(place, "(yaml)", message)
    return None


class _StopReadingError(Exception):
    def __init__(self, place: Place, path: str, message: str) -> None:
        super().__init__(message)
        self.place = place
        self.path = path
        self.message = message


@dataclass(frozen=True, slots=True)
class _Anchored:
    """A value that aliases may refer to, with what it costs to have it once more."""

    node: Node
    values: int
    depth: int


@dataclass(slots=True)
class _OpenCollection:
    """A list or mapping whose end has not been read yet."""

    place: Place
    path: str
    is_mapping: bool
    anchor: str | None
    array_tag: str | None
    values_before: int
    depth_below: int = 0
    items: list[Node] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)
    seen: dict[str, Place] = field(default_factory=dict)
    merged: list[tuple[Place, Node]] = field(default_factory=list)
    key_is_next: bool = True
    key: Scalar | None = None  # None at a value's turn: its key was refused

    def child_path(self) -> str:
        if not self.is_mapping:
            return f"{self.path}[{len(self.items)}]"
        return self.path if self.key is None else join_path(self.path, self.key.text)


class _Composer:
    def __init__(self, file: str, report: Report) -> None:
        self._file = file
        self._report = report
        self._open: list[_OpenCollection] = []
        self._open_anchors: set[str] = set()
        self._anchored: dict[str, _Anchored] = {}
        self._values = 0
        self._root: Node | None = None
        self._documents = 0

    def run(self, text: str) -> Node | None:
        for event in yaml.parse(text, Loader=_Loader):
            if isinstance(event, yaml.ScalarEvent):
                self._count(1, event)
                self._finish(_Anchored(self._scalar(event), 1, 0), event.anchor)
            elif isinstance(event, yaml.CollectionStartEvent):
                self._count(1, event)
                self._begin(event)
            elif isinstance(event, yaml.CollectionEndEvent):
                self._end()
            elif isinstance(event, yaml.AliasEvent):
                self._alias(event)
            elif isinstance(event, yaml.DocumentStartEvent):
                self._documents += 1
                if self._documents > 1:
                    message = "a second document begins; one file holds one document"
                    raise _StopReadingError(self._place(event), "(yaml)", message)
        return self._root

    def _place(self, event: yaml.Event) -> Place:
        mark = event.start_mark
        assert mark is not None
        return Place(self._file, mark.line + 1, mark.column + 1)

    def _path(self) -> str:
        return (self._open[-1].child_path() if self._open else "") or "(top level)"

    def _count(self, values: int, event: yaml.Event) -> None:
        self._values += values
        if self._values > MOST_VALUES:
            why = (
                f"aliases grow this file to more than {MOST_VALUES} values"
                if isinstance(event, yaml.AliasEvent)
                else f"more than {MOST_VALUES} keys and values in one file"
            )
            raise _StopReadingError(self._place(event), "(yaml)", why)

    def _scalar(self, event: yaml.ScalarEvent) -> Scalar:
        place = self._place(event)
        is_key = self._at_key()
        # A key is the text it is written as: `1:` and `"1":` are the same key.
        tag = None if is_key else event.tag
        plain = not is_key and event.tag is None and event.implicit[0]
        try:
            kind, value = resolve_scalar(event.value, tag, plain=plain)
        except ScalarRefusedError as error:
            message = str(error)
            if tag in ARRAY_TAGS:
                message = f"the tag {tag} belongs to a list: {tag} [...]"
            self._report.add(place, self._path(), message)
            kind, value = ScalarKind.INVALID, None
        if kind is ScalarKind.NULL and self._open:
            self._report.add(place, self._path(), _NO_VALUE)
            kind = ScalarKind.INVALID
        if not event.value.isascii() and any("\ud800" <= one <= "\udfff" for one in event.value):
            self._report.add(place, self._path(), "half of a surrogate pair is not a character")
            kind = ScalarKind.INVALID
        return Scalar(place, kind, value, event.value, event.implicit[0])

    def _at_key(self) -> bool:
        return bool(self._open) and self._open[-1].is_mapping and self._open[-1].key_is_next

    def _begin(self, event: yaml.CollectionStartEvent) -> None:
        place = self._place(event)
        path = self._open[-1].child_path() if self._open else ""
        if len(self._open) >= DEEPEST:
            self._refuse_depth(place)
        is_mapping = isinstance(event, yaml.MappingStartEvent)
        array_tag = event.tag if event.tag in ARRAY_TAGS and not is_mapping else None
        if array_tag is None and event.tag not in _PLAIN_COLLECTION_TAGS[type(event)]:
            message = unknown_tag(event.tag or "")
            if event.tag in ARRAY_TAGS:
                message = f"the tag {shown_tag(event.tag)} belongs to a list"
            self._report.add(place, path or "(top level)", message)
        if event.anchor is not None:
            self._open_anchors.add(event.anchor)
        self._open.append(
            _OpenCollection(place, path, is_mapping, event.anchor, array_tag, self._values - 1)
        )

    def _end(self) -> None:
        ended = self._open.pop()
        node: Node
        if ended.is_mapping:
            node = Mapping(ended.place, self._merge(ended))
        else:
            node = Sequence(ended.place, tuple(ended.items), ended.array_tag)
        if ended.anchor is not None:
            self._open_anchors.discard(ended.anchor)
        values = self._values - ended.values_before
        self._finish(_Anchored(node, values, ended.depth_below + 1), ended.anchor)

    def _alias(self, event: yaml.AliasEvent) -> None:
        name = event.anchor
        if name in self._open_anchors:
            message = f"the alias *{name} stands inside of the value it refers to"
            raise _StopReadingError(self._place(event), self._path(), message)
        if name not in self._anchored:
            message = f"the alias *{name} has no anchor &{name} before it"
            raise _StopReadingError(self._place(event), self._path(), message)
        anchored = self._anchored[name]
        self._count(anchored.values, event)
        if len(self._open) + anchored.depth > DEEPEST:
            self._refuse_depth(self._place(event))
        self._finish(anchored, None)

    def _refuse_depth(self, place: Place) -> NoReturn:
        raise _StopReadingError(place, "(yaml)", f"nested deeper than {DEEPEST} levels")

    def _finish(self, complete: _Anchored, anchor: str | None) -> None:
        """Hand the complete value to the collection it stands in."""
        node = complete.node
        if anchor is not None:
            self._anchored[anchor] = complete
        if not self._open:
            self._root = node
            return
        parent = self._open[-1]
        parent.depth_below = max(parent.depth_below, complete.depth)
        if not parent.is_mapping:
            parent.items.append(node)
        elif parent.key_is_next:
            parent.key = self._accepted_key(parent, node)
            parent.key_is_next = False
        else:
            if parent.key is not None and parent.key.text == "<<" and parent.key.plain:
                parent.merged.append((node.place, node))
            elif parent.key is not None:
                parent.entries.append(Entry(parent.key.text, parent.key.place, node))
            parent.key = None
            parent.key_is_next = True

    def _accepted_key(self, parent: _OpenCollection, node: Node) -> Scalar | None:
        path = parent.path or "(top level)"
        if not isinstance(node, Scalar):
            self._report.add(node.place, path, "a key must be a word, not a list or a mapping")
            return None
        if node.kind is ScalarKind.INVALID:
            return None
        if not node.text:
            self._report.add(node.place, path, "a key is missing before the colon")
            return None
        first = parent.seen.get(node.text)
        if first is not None:
            message = f"the key {excerpt(node.text)} is given twice, first at {first}"
            self._report.add(node.place, join_path(parent.path, node.text), message)
            return None
        parent.seen[node.text] = node.place
        return node

    def _merge(self, ended: _OpenCollection) -> dict[str, Entry]:
        """Add the entries of merge keys; keys of the mapping itself go first, then list order."""
        entries = {entry.key: entry for entry in ended.entries}
        for place, merged in ended.merged:
            sources = merged.items if isinstance(merged, Sequence) else (merged,)
            for source in sources:
                if isinstance(source, Mapping):
                    for entry in source.entries:
                        entries.setdefault(entry.key, entry)
                elif not (isinstance(source, Scalar) and source.kind is ScalarKind.INVALID):
                    message = "`<<` takes a mapping or a list of mappings to merge in"
                    self._report.add(place, join_path(ended.path, "<<"), message)
        return entries
