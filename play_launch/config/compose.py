"""Compose the tree of a YAML text from the parser's events, within limits.

PyYAML's own composer recurses in C without a limit (deep nesting ends the process), follows aliases
without counting, keeps the last of two equal keys, and refuses an anchor that is given twice, which
YAML allows. Its nodes do not tell whether a tag was written or concluded by the rules of YAML 1.1.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import yaml
from msgspec import Struct, field
from msgspec.structs import replace

from play_launch.config.problems import Location, Problem, excerpt, join_path
from play_launch.config.substitutions import PackageMissingError, may_hold_substitutions
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
_TOO_DEEP = f"nested deeper than {DEEPEST} levels"
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


class Tally(Struct):
    """Counts keys and values; shared by files that become one configuration."""

    most: int = MOST_VALUES
    values: int = 0


class Reading(Struct, frozen=True):
    """Options of reading a text.

    `included_from` is where another file includes this one. `substitute` substitutes in a text; it
    raises ValueError with the fix. With `nulls`, null is a value.
    """

    included_from: Location | None = None
    substitute: Callable[[str], str] | None = None
    tally: Tally = field(default_factory=Tally)
    nulls: bool = False


def compose(text: str, file: str, report: Report, reading: Reading | None = None) -> Node | None:
    """Return the tree of the only document in `text`, or None without one.

    Problems go to `report`: what is wrong with the syntax ends the reading, a key given twice
    or a useless tag does not.
    """
    reading = reading or Reading()
    try:
        events = iter(yaml.parse(text, Loader=_Loader))
        return _Composer(events, file, report, reading).run()
    except _StopReadingError as stop:
        location, path, message = stop.args
    except yaml.YAMLError as error:
        (location, message), path = _explain(error, text, file), "(yaml)"
    report.add(replace(location, included_from=reading.included_from), path, message)
    return None


class _StopReadingError(Exception):
    """Location, path and message of a problem after which the file is not read on."""


class _Composer:
    """Descends into the events; `DEEPEST` bounds its recursion."""

    def __init__(
        self, events: Iterator[yaml.Event], file: str, report: Report, reading: Reading
    ) -> None:
        self._events = events
        self._file = file
        self._report = report
        self._reading = reading
        self._anchored: dict[str, Node] = {}
        self._open_anchors: set[str] = set()
        self._depth = 0

    def run(self) -> Node | None:
        root: Node | None = None
        documents = 0
        for event in self._events:
            if isinstance(event, yaml.NodeEvent):
                root = self._node(event, "")
            elif isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    message = "a second document begins; one file holds one document"
                    raise _StopReadingError(self._location(event), "(yaml)", message)
        return root

    def _node(self, event: yaml.Event, path: str, *, is_key: bool = False) -> Node:
        """Read the value that begins with `event` to its end."""
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event, path)
        self._count(1, event)
        node: Node
        if isinstance(event, yaml.ScalarEvent):
            node = self._scalar(event, path, is_key=is_key)
        else:
            assert isinstance(event, yaml.CollectionStartEvent)
            array_tag = self._begin(event, path)
            if isinstance(event, yaml.MappingStartEvent):
                node = self._mapping(event, path)
            else:
                node = self._sequence(event, path, array_tag)
            self._depth -= 1
            self._open_anchors.discard(event.anchor)
        if event.anchor is not None:
            self._anchored[event.anchor] = node
        return node

    def _location(self, event: yaml.Event) -> Location:
        mark = event.start_mark
        assert mark is not None
        return Location(self._file, mark.line + 1, mark.column + 1, self._reading.included_from)

    def _problem(self, location: Location, path: str, message: str) -> None:
        self._report.add(location, path or "(top level)", message)

    def _count(self, values: int, event: yaml.Event) -> None:
        tally = self._reading.tally
        tally.values += values
        if tally.values > tally.most:
            message = f"more than {tally.most} keys and values in one file and what it includes"
            if isinstance(event, yaml.AliasEvent):
                message = f"aliases grow this file to more than {tally.most} values"
            raise _StopReadingError(self._location(event), "(yaml)", message)

    def _scalar(self, event: yaml.ScalarEvent, path: str, *, is_key: bool) -> Scalar:
        location = self._location(event)
        # A key is the text it is written as: `1:` and `"1":` are the same key.
        tag = None if is_key else event.tag
        plain = not is_key and event.tag is None and event.implicit[0]
        text = event.value
        problem = ""
        kind, value = ScalarKind.INVALID, None
        try:
            if self._reading.substitute is not None and may_hold_substitutions(text):
                text = _refuse_in_key(text) if is_key else self._reading.substitute(text)
            kind, value = resolve_scalar(text, tag, plain=plain)
        except PackageMissingError as error:
            self._report.missing_packages[location] = Problem.at(location, path, str(error))
            kind, value = ScalarKind.STRING, text
        except ValueError as error:
            problem = str(error)
            if tag in ARRAY_TAGS:
                problem = f"the tag {tag} belongs to a list: {tag} [...]"
        substituted = text != event.value
        if kind is ScalarKind.NULL and substituted:
            kind, value = ScalarKind.STRING, text
        if kind is ScalarKind.NULL and self._depth > 0 and not self._reading.nulls:
            problem = _NO_VALUE
        if not text.isascii() and any("\ud800" <= one <= "\udfff" for one in text):
            problem = "half of a surrogate pair is not a character"
        if problem:
            self._problem(location, path, problem)
            kind = ScalarKind.INVALID
        return Scalar(location, kind, value, text, event.implicit[0], substituted)

    def _begin(self, event: yaml.CollectionStartEvent, path: str) -> str | None:
        """Enter a list or a mapping; returns the tag of a ROS array."""
        location = self._location(event)
        self._check_depth(1, location)
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

    def _check_depth(self, levels: int, location: Location) -> None:
        if self._depth + levels > DEEPEST:
            raise _StopReadingError(location, "(yaml)", _TOO_DEEP)

    def _inside(self) -> Iterator[yaml.Event]:
        """Yield the events that begin the parts of the collection that is open."""
        for event in self._events:
            if isinstance(event, yaml.CollectionEndEvent):
                return
            yield event

    def _sequence(self, event: yaml.Event, path: str, array_tag: str | None) -> Sequence:
        items: list[Node] = []
        for begin in self._inside():
            items.append(self._node(begin, f"{path}[{len(items)}]"))
        return Sequence(self._location(event), tuple(items), array_tag)

    def _mapping(self, event: yaml.Event, path: str) -> Mapping:
        entries: dict[str, Entry] = {}
        seen: dict[str, Location] = {}
        merged: list[Node] = []
        for begin in self._inside():
            key = self._accepted_key(self._node(begin, path, is_key=True), path, seen)
            below = path if key is None else join_path(path, key.text)
            value = self._node(next(self._events), below)
            if key is None:
                continue
            if key.text == "<<" and key.plain:
                merged.append(value)
            else:
                entries[key.text] = Entry(key.text, key.location, value)
        for node in merged:
            self._merge(node, entries, join_path(path, "<<"))
        return Mapping(self._location(event), entries)

    def _alias(self, event: yaml.AliasEvent, path: str) -> Node:
        name = event.anchor or ""
        location = self._location(event)
        message = ""
        if name in self._open_anchors:
            message = f"the alias *{name} stands inside of the value it refers to"
        elif name not in self._anchored:
            message = f"the alias *{name} has no anchor &{name} before it"
        if message:
            raise _StopReadingError(location, path or "(top level)", message)
        node = self._anchored[name]
        # As if its text stood there; it was counted itself, which bounds this walk.
        values, levels = _extent(node)
        self._count(values, event)
        self._check_depth(levels, location)
        return node

    def _accepted_key(self, node: Node, path: str, seen: dict[str, Location]) -> Scalar | None:
        if not isinstance(node, Scalar):
            self._problem(node.location, path, "a key must be a word, not a list or a mapping")
            return None
        if node.kind is ScalarKind.INVALID:
            return None
        if not node.text:
            self._problem(node.location, path, "a key is missing before the colon")
            return None
        first = seen.setdefault(node.text, node.location)
        if first is not node.location:
            message = f"the key {excerpt(node.text)} is given twice, first at {first}"
            self._report.add(node.location, join_path(path, node.text), message)
            return None
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
    if any(begin in text for begin in ("${env:", "${arg:", "$(find-pkg-share")):
        raise ValueError("a key takes no substitution, only a value does")
    return text


def _extent(node: Node) -> tuple[int, int]:
    """Return the number of keys and values in a node, itself included, and its levels."""
    if isinstance(node, Scalar):
        return 1, 0
    parts = node.items if isinstance(node, Sequence) else [each.value for each in node.entries]
    inside = [_extent(part) for part in parts]
    keys = len(inside) if isinstance(node, Mapping) else 0
    values = 1 + keys + sum(count for count, _ in inside)
    return values, 1 + max((levels for _, levels in inside), default=0)


def _explain(error: yaml.YAMLError, text: str, file: str) -> tuple[Location, str]:
    """Describe a syntax error, with a fix for the common ones."""
    begin = getattr(error, "context_mark", None)
    mark = getattr(error, "problem_mark", None) or begin
    if mark is None:
        return Location(file, 1, 1), f"is not YAML: {excerpt(str(error))[1:-1]}"
    lines = text.splitlines()
    tab = _INDENTATION_TAB.match(lines[mark.line]) if mark.line < len(lines) else None
    if tab is not None:
        return Location(file, mark.line + 1, tab.end()), "a tab cannot indent YAML; use spaces"
    location = Location(file, mark.line + 1, mark.column + 1)
    context = getattr(error, "context", None)
    problem = getattr(error, "problem", None) or context or "not YAML"
    message = str(problem)
    if "maximum nesting depth" in message:  # PyYAML 6.0.4 and later read ahead, and refuse it first
        return location, _TOO_DEEP
    if context and context != problem:
        message += f" {context}"
        if begin is not None and (begin.line, begin.column) != (mark.line, mark.column):
            message += f" that begins at {begin.line + 1}:{begin.column + 1}"
    fix = next((advice for symptom, advice in _FIXES if symptom in message), None)
    return location, message if fix is None else f"{message}; {fix}"
