"""Puts the tree of a YAML text together, within bounds.

It is put together from the parser's events rather than by PyYAML's composer. That one recurses in C
without a limit (deep nesting ends the process), follows aliases without counting, keeps the last of
two equal keys, refuses an anchor that is given twice, which YAML allows, and gives up at the first
error of the syntax, whatever is wrong before it. Its nodes do not say either whether a tag was
written or concluded by the rules of YAML 1.1. To scan the events for bounds and let it compose then
was weighed: the scan needs as many lines as the following of aliases here, and parses twice.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NoReturn

import yaml
from msgspec import Struct, field
from msgspec.structs import replace

from play_launch.config.problems import Location, excerpt, join_path
from play_launch.config.substitutions import may_hold_substitutions
from play_launch.config.tree import (
    Entry,
    Mapping,
    Node,
    Scalar,
    ScalarKind,
    Sequence,
    resolve_scalar,
    shown_tag,
    unknown_tag,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from play_launch.config.problems import Report

MOST_VALUES = 200_000
"""Keys and values in a file and all it includes, aliases counted as if their text stood there."""
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
_INDENTATION_TAB = re.compile(r"[ \-?:]*\t")
_FIXES = (
    ("mapping values are not allowed", 'quote text that holds ": ", or check the indentation'),
    ("found character that cannot start any token", "put the text in quotes"),
    ("found unexpected end of stream", "a quotation mark is not closed"),
    ("did not find expected key", "check the indentation of this line and the one before"),
    ("did not find expected '-' indicator", "a list goes on with `- `; check the indentation"),
    ("did not find expected ',' or", "a bracket is not closed or a comma is missing"),
    ("did not find expected <document start>", "only one value may stand at the top"),
    ("did not find expected node content", "a value is missing before this"),
    ("could not find expected ':'", "a key needs a colon and a space after it"),
    ("found undefined tag handle", "write the value without the tag"),
    ("incompatible YAML document", "leave the %YAML line out"),
)
# libyaml does not come with every build of PyYAML; the parser in Python is slower, not different.
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class Tally:
    """Counts keys and values; shared by files that become one configuration."""

    def __init__(self, most: int = MOST_VALUES) -> None:
        self.most = most
        self.values = 0


class Reading(Struct, frozen=True):
    """How a text is read, where that is not as usual.

    `included_from` is where another file includes this one. `substitute` carries out what stands
    in a text; it raises ValueError with the fix. With `nulls`, null is a value.
    """

    included_from: Location | None = None
    substitute: Callable[[str], str] | None = None
    tally: Tally = field(default_factory=Tally)
    nulls: bool = False


def compose(text: str, file: str, report: Report, reading: Reading | None = None) -> Node | None:
    """Return the tree of the only document in `text`, or None without one.

    Problems go to `report`: what is wrong with the syntax ends the reading, a key given twice
    or a tag of no use does not.
    """
    reading = reading or Reading()
    try:
        events = iter(yaml.parse(text, Loader=_Loader))
        return _Composer(events, file, report, reading).run()
    except _StopReadingError as stop:
        location, path, message = stop.location, stop.path, stop.message
    except yaml.YAMLError as error:
        (location, message), path = _explain(error, text, file), "(yaml)"
    report.add(replace(location, included_from=reading.included_from), path, message)
    return None


class _StopReadingError(Exception):
    def __init__(self, location: Location, path: str, message: str) -> None:
        super().__init__(message)
        self.location = location
        self.path = path
        self.message = message


class _Found(Struct, frozen=True):
    """A value with its keys and values, itself included, and the levels below it.

    That is what it costs to have it once more, by an alias.
    """

    node: Node
    values: int
    depth: int


class _Composer:
    """Descends into the events; `DEEPEST` bounds its recursion."""

    def __init__(
        self, events: Iterator[yaml.Event], file: str, report: Report, reading: Reading
    ) -> None:
        self._events = events
        self._file = file
        self._report = report
        self._reading = reading
        self._tally = reading.tally
        self._anchored: dict[str, _Found] = {}
        self._open_anchors: set[str] = set()
        self._depth = 0

    def run(self) -> Node | None:
        root: Node | None = None
        documents = 0
        for event in self._events:
            if isinstance(event, yaml.NodeEvent):
                root = self._node(event, "").node
            elif isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    message = "a second document begins; one file holds one document"
                    raise _StopReadingError(self._place(event), "(yaml)", message)
        return root

    def _node(self, event: yaml.Event, path: str, *, is_key: bool = False) -> _Found:
        """Read the value that begins with `event` to its end."""
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event, path)
        values_before = self._tally.values
        self._count(1, event)
        node: Node
        deepest = -1
        if isinstance(event, yaml.ScalarEvent):
            node = self._scalar(event, path, is_key=is_key)
        else:
            assert isinstance(event, yaml.CollectionStartEvent)
            array_tag = self._begin(event, path)
            if isinstance(event, yaml.MappingStartEvent):
                node, deepest = self._mapping(event, path)
            else:
                node, deepest = self._sequence(event, path, array_tag)
            self._depth -= 1
            self._open_anchors.discard(event.anchor)
        found = _Found(node, self._tally.values - values_before, deepest + 1)
        if event.anchor is not None:
            self._anchored[event.anchor] = found
        return found

    def _place(self, event: yaml.Event) -> Location:
        mark = event.start_mark
        assert mark is not None
        return Location(self._file, mark.line + 1, mark.column + 1, self._reading.included_from)

    def _problem(self, location: Location, path: str, message: str) -> None:
        self._report.add(location, path or "(top level)", message)

    def _count(self, values: int, event: yaml.Event) -> None:
        self._tally.values += values
        most = self._tally.most
        if self._tally.values > most:
            why = (
                f"aliases grow this file to more than {most} values"
                if isinstance(event, yaml.AliasEvent)
                else f"more than {most} keys and values in one file and what it includes"
            )
            raise _StopReadingError(self._place(event), "(yaml)", why)

    def _scalar(self, event: yaml.ScalarEvent, path: str, *, is_key: bool) -> Scalar:
        location = self._place(event)
        # A key is the text it is written as: `1:` and `"1":` are the same key.
        tag = None if is_key else event.tag
        plain = not is_key and event.tag is None and event.implicit[0]
        text = event.value
        try:
            if self._reading.substitute is not None and may_hold_substitutions(text):
                text = _refuse_in_key(text) if is_key else self._reading.substitute(text)
            kind, value = resolve_scalar(text, tag, plain=plain)
        except ValueError as error:
            message = str(error)
            if tag in ARRAY_TAGS:
                message = f"the tag {tag} belongs to a list: {tag} [...]"
            self._problem(location, path, message)
            kind, value = ScalarKind.INVALID, None
        substituted = text != event.value
        if kind is ScalarKind.NULL and substituted:
            kind, value = ScalarKind.STRING, text
        if kind is ScalarKind.NULL and self._depth > 0 and not self._reading.nulls:
            self._problem(location, path, _NO_VALUE)
            kind = ScalarKind.INVALID
        if not text.isascii() and any("\ud800" <= one <= "\udfff" for one in text):
            self._problem(location, path, "half of a surrogate pair is not a character")
            kind = ScalarKind.INVALID
        return Scalar(location, kind, value, text, event.implicit[0], substituted)

    def _begin(self, event: yaml.CollectionStartEvent, path: str) -> str | None:
        """Enter a list or a mapping; returns the tag of a ROS array."""
        location = self._place(event)
        if self._depth >= DEEPEST:
            self._refuse_depth(location)
        is_mapping = isinstance(event, yaml.MappingStartEvent)
        array_tag = event.tag if event.tag in ARRAY_TAGS and not is_mapping else None
        if array_tag is None and event.tag not in _PLAIN_COLLECTION_TAGS[type(event)]:
            message = unknown_tag(event.tag or "")
            if event.tag in ARRAY_TAGS:
                message = f"the tag {shown_tag(event.tag)} belongs to a list"
            self._problem(location, path, message)
        if event.anchor is not None:
            self._open_anchors.add(event.anchor)
        self._depth += 1
        return array_tag

    def _inside(self) -> Iterator[yaml.Event]:
        """Yield the events that begin the parts of the collection that is open."""
        for event in self._events:
            if isinstance(event, yaml.CollectionEndEvent):
                return
            yield event

    def _sequence(
        self, event: yaml.Event, path: str, array_tag: str | None
    ) -> tuple[Sequence, int]:
        items: list[Node] = []
        deepest = 0
        for begin in self._inside():
            item = self._node(begin, f"{path}[{len(items)}]")
            items.append(item.node)
            deepest = max(deepest, item.depth)
        return Sequence(self._place(event), tuple(items), array_tag), deepest

    def _mapping(self, event: yaml.Event, path: str) -> tuple[Mapping, int]:
        entries: dict[str, Entry] = {}
        seen: dict[str, Location] = {}
        merged: list[Node] = []
        deepest = 0
        for begin in self._inside():
            key_found = self._node(begin, path, is_key=True)
            key = self._accepted_key(key_found.node, path, seen)
            below = path if key is None else join_path(path, key.text)
            value = self._node(next(self._events), below)
            deepest = max(deepest, key_found.depth, value.depth)
            if key is None:
                continue
            if key.text == "<<" and key.plain:
                merged.append(value.node)
            else:
                entries[key.text] = Entry(key.text, key.location, value.node)
        for node in merged:
            self._merge(node, entries, join_path(path, "<<"))
        return Mapping(self._place(event), entries), deepest

    def _alias(self, event: yaml.AliasEvent, path: str) -> _Found:
        name = event.anchor
        location = self._place(event)
        path = path or "(top level)"
        if name in self._open_anchors:
            message = f"the alias *{name} stands inside of the value it refers to"
            raise _StopReadingError(location, path, message)
        if name not in self._anchored:
            message = f"the alias *{name} has no anchor &{name} before it"
            raise _StopReadingError(location, path, message)
        found = self._anchored[name]
        self._count(found.values, event)
        if self._depth + found.depth > DEEPEST:
            self._refuse_depth(location)
        return found

    def _refuse_depth(self, location: Location) -> NoReturn:
        raise _StopReadingError(location, "(yaml)", f"nested deeper than {DEEPEST} levels")

    def _accepted_key(self, node: Node, path: str, seen: dict[str, Location]) -> Scalar | None:
        if not isinstance(node, Scalar):
            self._problem(node.location, path, "a key must be a word, not a list or a mapping")
            return None
        if node.kind is ScalarKind.INVALID:
            return None
        if not node.text:
            self._problem(node.location, path, "a key is missing before the colon")
            return None
        first = seen.get(node.text)
        if first is not None:
            message = f"the key {excerpt(node.text)} is given twice, first at {first}"
            self._report.add(node.location, join_path(path, node.text), message)
            return None
        seen[node.text] = node.location
        return node

    def _merge(self, merged: Node, entries: dict[str, Entry], path: str) -> None:
        """Add the entries of a merge key; what is there goes first, then the order of the list."""
        for source in merged.items if isinstance(merged, Sequence) else (merged,):
            if isinstance(source, Mapping):
                for entry in source.entries:
                    entries.setdefault(entry.key, entry)
            elif not (isinstance(source, Scalar) and source.kind is ScalarKind.INVALID):
                message = "`<<` takes a mapping or a list of mappings to merge in"
                self._report.add(merged.location, path, message)


def _refuse_in_key(text: str) -> str:
    """Return the text of a key; raise ValueError for a substitution in it."""
    if any(begin in text for begin in ("${env:", "${arg:", "$(find-pkg-share")):
        raise ValueError("a key takes no substitution, only a value does")
    return text


def _explain(error: yaml.YAMLError, text: str, file: str) -> tuple[Location, str]:
    """Describe a syntax error, with a fix for the common ones."""
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    if mark is None:
        return Location(file, 1, 1), f"is not YAML: {excerpt(str(error))[1:-1]}"
    tab = _tab_in_indentation(text, mark.line)
    if tab is not None:
        return Location(file, mark.line + 1, tab + 1), "a tab cannot indent YAML; use spaces"
    problem = getattr(error, "problem", None) or getattr(error, "context", None) or "not YAML"
    message = str(problem)
    if "maximum nesting depth" in message:  # PyYAML 6.0.4 and later read ahead, and refuse it first
        return Location(
            file, mark.line + 1, mark.column + 1
        ), f"nested deeper than {DEEPEST} levels"
    context = getattr(error, "context", None)
    begin = getattr(error, "context_mark", None)
    if context and context != problem:
        message += f" {context}"
        if begin is not None and (begin.line, begin.column) != (mark.line, mark.column):
            message += f" that begins at {begin.line + 1}:{begin.column + 1}"
    fix = next((advice for symptom, advice in _FIXES if symptom in message), None)
    if fix is not None:
        message += f"; {fix}"
    return Location(file, mark.line + 1, mark.column + 1), message


def _tab_in_indentation(text: str, line: int) -> int | None:
    lines = text.splitlines()
    if line >= len(lines):
        return None
    found = _INDENTATION_TAB.match(lines[line])
    return None if found is None else found.end() - 1
