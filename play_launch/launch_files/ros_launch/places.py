"""Where the parts of a launch description stand, and errors in words.

What a Python launch file makes stands where the innermost call in a launch file is. XML and YAML
come without lines from ROS's launch, so their files are read a second time for the lines alone.
"""

from __future__ import annotations

import os
import re
import sys
import xml.parsers.expat
from contextlib import contextmanager
from pathlib import Path
from traceback import walk_tb
from typing import TYPE_CHECKING, Any, Final
from xml.etree.ElementTree import ParseError

import yaml

from play_launch.launch_files.records import LaunchOrigin, Place

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from types import FrameType, TracebackType

_ATTRIBUTE: Final = "_play_launch_origin"
_OWN: Final = str(Path(__file__).parent)
NOWHERE: Final = Place()
_SAID: Final = frozenset(
    {"RuntimeError", "Exception", "SubstitutionFailure", "PackageNotFoundError"}
)
"""Errors whose class adds nothing to their text."""
_NOT_SET: Final = re.compile(r"launch configuration '(\S+)' does not exist")
_NO_ATTRIBUTE: Final = re.compile(r"Attribute '(\S+)' of type .* not found in Entity '(\S+)'")
_OF_ROS_1: Final = {"find": "$(find-pkg-share PACKAGE)", "arg": "$(var NAME)"}


class Places:
    """What is known about places while a description is loaded and visited.

    `files` are the launch files read so far. `includes` are the places of the includes that led to
    what is visited, the outermost first. `visited` is where that stands, as far as it is known.
    """

    def __init__(self, library_folders: tuple[str, ...]) -> None:
        self.files: list[str] = []
        self.includes: list[Place] = []
        self.visited = NOWHERE
        self._within: list[Place] = []
        self._libraries = (*library_folders, _OWN)
        self._elements: dict[int, tuple[Any, Place]] = {}

    # Files

    def file_read(self, path: str) -> None:
        """Note that a launch file is being read."""
        absolute = str(Path(path).absolute())
        if absolute not in self.files:
            self.files.append(absolute)

    def element_read(self, element: Any, place: Place) -> None:
        """Note where an element of an XML or YAML file stands; it is kept, so that its id stays."""
        self._elements[id(element)] = (element, place)

    def of_element(self, element: Any) -> Place:
        """Return where an element stands."""
        return self._elements.get(id(element), (None, NOWHERE))[1]

    # What is made

    def made(self, part: object) -> None:
        """Note where a part of a description is made."""
        place = self._within[-1] if self._within else self.of_frames(sys._getframe(1))  # noqa: SLF001
        part.__dict__.setdefault(_ATTRIBUTE, place)

    def of_frames(self, frame: FrameType | None) -> Place:
        """Return the innermost place in a launch file, else the innermost outside of libraries."""
        first = NOWHERE
        while frame is not None:
            place = Place(frame.f_code.co_filename, frame.f_lineno)
            if place.file in self.files:
                return place
            if not first.file and self._is_of_user(place.file):
                first = place
            frame = frame.f_back
        return first

    def of_part(self, part: object) -> Place:
        """Return where a part was made."""
        place = getattr(part, _ATTRIBUTE, NOWHERE)
        return place if isinstance(place, Place) else NOWHERE

    def of_traceback(self, traceback: TracebackType | None) -> Place:
        """Return the innermost place of a traceback that is in a launch file."""
        found = NOWHERE
        for frame, line in walk_tb(traceback):
            if frame.f_code.co_filename in self.files:
                found = Place(frame.f_code.co_filename, line)
        return found

    def _is_of_user(self, file: str) -> bool:
        return file.startswith("/") and not file.startswith(self._libraries)

    # What is going on

    @contextmanager
    def parsing(self, place: Place) -> Iterator[None]:
        """While an element of an XML or YAML file is made into parts."""
        if not place.file:
            yield
            return
        self._within.append(place)
        try:
            yield
        except BaseException as error:
            self.annotate(error, place)
            raise
        finally:
            self._within.pop()

    @contextmanager
    def no_parsing(self) -> Iterator[None]:
        """While a further launch file is read, which has places of its own."""
        within, self._within = self._within, []
        try:
            yield
        finally:
            self._within = within

    def origin(self, place: Place) -> LaunchOrigin:
        """Return a place with the includes that led there."""
        return _origin(place, self.includes)

    def annotate(self, error: BaseException, place: Place) -> None:
        """Note where an error arose; the first place that is known stays."""
        if place.file and not hasattr(error, _ATTRIBUTE):
            setattr(error, _ATTRIBUTE, (place, list(self.includes)))

    def of_error(self, errors: Sequence[BaseException], place: Place) -> LaunchOrigin:
        """Return where an error arose, the first of those that led to one another.

        A place that the error itself names counts most.
        """
        noted = [found for each in errors if (found := getattr(each, _ATTRIBUTE, None))]
        own, includes = noted[0] if noted else (self._last_file(), [])
        return _origin(place if place.file else own, includes)

    def of_visited(self) -> LaunchOrigin:
        """Return what is going on, for what happens in no launch file."""
        if self._within:
            return self.origin(self._within[-1])
        return self.origin(self.visited if self.visited.file else self._last_file())

    def _last_file(self) -> Place:
        return Place(self.files[-1]) if self.files else NOWHERE


def _origin(place: Place, includes: Sequence[Place]) -> LaunchOrigin:
    # What includes itself is named once.
    chain = tuple(dict.fromkeys(reversed(includes)))
    # An include that cannot be carried out is no part of its own chain.
    return LaunchOrigin(place, chain[1:] if chain and chain[0] == place else chain)


def xml_lines(text: bytes) -> list[int]:
    """Return the line of each element of an XML file, in the order of the document."""
    lines: list[int] = []
    parser = xml.parsers.expat.ParserCreate()
    parser.StartElementHandler = lambda *_: lines.append(parser.CurrentLineNumber)
    parser.Parse(text, True)
    return lines


def yaml_lines(node: yaml.Node, value: object) -> Iterator[tuple[object, int]]:
    """Return the mappings and lists of a YAML file, each with its line from 1."""
    yield value, node.start_mark.line + 1
    if isinstance(node, yaml.MappingNode) and isinstance(value, dict):
        # A mapping keeps the order of its keys; one that stands twice leaves the places unknown.
        if len(node.value) == len(value):
            for (key, below), held in zip(node.value, value.values(), strict=True):
                if isinstance(held, dict | list):
                    yield from yaml_lines(below, held)
                    # What a reader looks for is the line with the key.
                    yield held, key.start_mark.line + 1
    elif isinstance(node, yaml.SequenceNode) and isinstance(value, list):
        for below, held in zip(node.value, value, strict=False):
            yield from yaml_lines(below, held)


def trail(error: BaseException) -> list[BaseException]:
    """Return the first of the errors that launch collects, and those that followed from it."""
    found = [error]
    while likely := getattr(found[0], "_likely_errors", None):
        found.insert(0, likely[0])
    return found


def reason_of(error: BaseException, places: Places) -> tuple[str, Place]:
    """Return what is wrong, and where if the error itself has the place."""
    file = places.files[-1] if places.files else ""
    if isinstance(error, SystemExit):
        code = 0 if error.code is None else error.code
        return f"it calls exit({code!r}) while it is evaluated", places.of_traceback(
            error.__traceback__
        )
    # A ParseError is a SyntaxError, too.
    if isinstance(error, ParseError):
        what = str(error).rpartition(": line ")[0]
        return f"is not XML: {what}", Place(file, error.position[0])
    if isinstance(error, SyntaxError):
        return f"SyntaxError: {error.msg}", Place(error.filename or file, error.lineno or 0)
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        mark = error.problem_mark
        named = mark.name if Path(str(mark.name)).is_file() else file
        return f"is not YAML: {error.problem}", Place(named, mark.line + 1)
    if isinstance(error, UnicodeDecodeError):
        where = places.of_traceback(error.__traceback__)
        return f"is not UTF-8 at byte {error.start}", where if where.file else Place(file)
    if isinstance(error, RecursionError):
        what = "it is nested too deeply, or calls itself without end"
        return what, places.of_traceback(error.__traceback__)
    if isinstance(error, OSError) and error.strerror and error.filename:
        named = os.fsdecode(error.filename)
        return f"{error.strerror}: {named}", places.of_traceback(error.__traceback__)
    return _text(error), places.of_traceback(error.__traceback__)


def _text(error: BaseException) -> str:
    kind = type(error).__name__
    # A KeyError shows its text in quotes.
    text = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
    if text.startswith("Required launch argument"):
        return f"{text.rstrip('.')}; give it as name:=value"
    if type(error).__module__.split(".")[0] == "lark":
        if (cause := getattr(error, "orig_exc", None)) is not None:
            return _text(cause)
        # What the grammar expects follows in many lines.
        return f"a substitution is not written as launch wants it: {text.splitlines()[0]}"
    if instead := _OF_ROS_1.get(text.removeprefix("Unknown substitution: ")):
        return f"{text}; it is of ROS 1, in ROS 2 it is {instead}"
    if unset := _NOT_SET.fullmatch(text):
        return f"{text}; declare it, or give it as {unset[1]}:=value"
    if missing := _NO_ATTRIBUTE.match(text):
        hint = "; it was type in ROS 1" if missing[1] == "exec" else ""
        return f"{missing[2]} has no attribute {missing[1]}{hint}"
    return text if kind in _SAID and text else f"{kind}: {text}" if text else kind
