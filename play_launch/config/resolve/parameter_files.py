"""ROS parameter files, and parameters for all nodes of a process: sections by names of nodes.

In a file, each section has `ros__parameters` below its name. Which sections are for a node is
decided as rclcpp does it (`parameter_map_from`): a section's name is absolute, `*` stands for one
part, `**` for any number of parts, sections count in the order of the file.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.config.compose import compose
from play_launch.config.model import FOR_ALL, ParameterConfig, ParameterSection, SourceFile
from play_launch.config.problems import excerpt
from play_launch.config.resolve.parameters import KEY_IN_FILES, flatten
from play_launch.config.source import Refused, decode, path_from, read_bytes
from play_launch.config.tree import Cursor, Mapping, Scalar, ScalarKind, describe_node

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from play_launch.config.model import ParameterValue
    from play_launch.config.problems import Report

_PATTERN: Final = re.compile(r"(?:/(?:\*\*|\*|[A-Za-z_][A-Za-z0-9_]*))+", re.ASCII)
_FORM: Final = "a mapping of names of nodes to parameters"


class _Section(Struct):
    pattern: str
    at: Cursor
    values: dict[str, ParameterValue] | None = None

    def flat(self) -> dict[str, ParameterValue]:
        """Return its parameters; mistakes in them are reported at the first call."""
        if self.values is None:
            self.values = flatten(self.at, is_file=True)
        return self.values


class ParameterFileReader:
    """The parameter files of one configuration, each read once.

    Relative paths start at the directory of the file in which they stand.
    """

    def __init__(
        self, report: Report, read: Callable[[Path], bytes | Refused] = read_bytes
    ) -> None:
        self._read_bytes = read
        self._report = report
        self._sections: dict[Path, list[_Section] | Refused] = {}
        self.read: list[SourceFile] = []
        """The files that were read so far, in that order."""

    def select(self, at: Cursor, path: str, full_name: str | None) -> dict[str, ParameterValue]:
        """Return what the file at `path`, which stands there, holds for the node `full_name`."""
        values: dict[str, ParameterValue] = {}
        for section in self._sections_of(at, path):
            if section.pattern != FOR_ALL and full_name is None:
                at.problem(
                    f"{path_from(at, path)} has the section {excerpt(section.pattern)}, and "
                    "without a name it is not known whether that is this node; give the node a name"
                )
                break
            if full_name is None or matches(section.pattern, full_name):
                values.update(section.flat())
        return values

    def sections(self, at: Cursor, path: str) -> list[tuple[str, dict[str, ParameterValue]]]:
        """Return all that the file at `path` holds: patterns of nodes, and their parameters."""
        return [(each.pattern, each.flat()) for each in self._sections_of(at, path)]

    def _sections_of(self, at: Cursor, path: str) -> list[_Section]:
        if not path.strip() or "\x00" in path:
            at.problem("expected the path of a parameter file")
            return []
        if at.node.location in self._report.missing_packages:
            return []
        file = path_from(at, path)
        if file not in self._sections:
            self._sections[file] = self._read(file)
        sections = self._sections[file]
        if not isinstance(sections, Refused):
            return sections
        if sections.inside:
            self._report.add(sections.location, "(file)", sections.message)
        else:
            at.problem(f"the parameter file {file}: {sections.message}")
        return []

    def _read(self, file: Path) -> list[_Section] | Refused:
        content = self._read_bytes(file)
        if isinstance(content, Refused):
            return content
        self.read.append(SourceFile(file, content))
        text = decode(content, str(file))
        if isinstance(text, Refused):
            return text
        root = compose(text, str(file), self._report)
        sections: list[_Section] = []
        if isinstance(root, Mapping):
            _collect(Cursor(root, "", self._report), "", sections)
        elif root is not None and not (isinstance(root, Scalar) and root.kind is ScalarKind.NULL):
            Cursor(root, "", self._report).expected(f"node names with {KEY_IN_FILES} below")
        return sections


def _collect(at: Cursor, pattern: str, into: list[_Section]) -> None:
    """Walk down namespaces and names to the sections; nested names are joined with `/`."""
    for entry, value in at.entries():
        below = f"{pattern}/{entry.key.removeprefix('/')}"
        if entry.key == KEY_IN_FILES:
            if not pattern:
                message = f'{KEY_IN_FILES} needs a node name above it, or "{FOR_ALL}" for all'
                value.problem(message, entry.location)
            elif isinstance(value.node, Mapping):
                into.append(_Section(pattern, value))
            else:
                value.expected("parameter names and values")
        elif not _PATTERN.fullmatch(below):
            message = f"{excerpt(entry.key)} is neither {KEY_IN_FILES} nor the name of a node"
            value.problem(message, entry.location)
        elif isinstance(value.node, Mapping):
            _collect(value, below, into)
        else:
            value.expected(f"{KEY_IN_FILES} below a node name")


def matches(pattern: str, full_name: str) -> bool:
    """Return whether the pattern of a section is for a node.

    Matches part by part; `**` at its shortest first leaves one position to continue from.
    """
    parts = pattern.split("/")[1:]
    names = full_name.split("/")[1:]
    part = name = 0
    star: tuple[int, int] | None = None
    while name < len(names):
        if part < len(parts) and parts[part] == "**":
            star = (part, name)
            part += 1
        elif part < len(parts) and parts[part] in ("*", names[name]):
            part += 1
            name += 1
        elif star is not None:
            star = (star[0], star[1] + 1)
            part, name = star[0] + 1, star[1]
        else:
            return False
    return all(left == "**" for left in parts[part:])


def resolve_process_parameters(
    at: Cursor | None, files: ParameterFileReader
) -> tuple[ParameterSection, ...]:
    """Return the sections from the sources that stand there: mappings, and parameter files.

    As in rcl, a section counts where it is mentioned first, and within it the later value wins.
    """
    found: dict[str, dict[str, ParameterValue]] = {}
    if at is None:
        return ()
    if isinstance(at.node, Mapping):
        _add_sections(at, found)
    elif at.is_plain_list:
        for source in at.elements():
            if source.string is not None:
                for pattern, values in files.sections(source, source.string):
                    found.setdefault(pattern, {}).update(values)
            elif isinstance(source.node, Mapping):
                _add_sections(source, found)
            else:
                source.expected(f"{_FORM}, or the path of a parameter file")
    elif not at.is_invalid:
        fix = "; put the file into a list: [ ... ]" if at.string is not None else ""
        at.problem(f"expected {_FORM}, or a list, given {describe_node(at.node)}{fix}")
    return tuple(
        ParameterSection(pattern, tuple(map(ParameterConfig, values.keys(), values.values())))
        for pattern, values in found.items()
        if values
    )


def _add_sections(source: Cursor, found: dict[str, dict[str, ParameterValue]]) -> None:
    for entry, value in source.entries():
        pattern = f"/{entry.key.removeprefix('/')}"
        if not _PATTERN.fullmatch(pattern):
            message = (
                f"{excerpt(entry.key)} is not the full name of a node, nor a pattern such as /**"
            )
            value.problem(message, entry.location)
        elif isinstance(value.node, Mapping):
            found.setdefault(pattern, {}).update(flatten(value))
        else:
            value.expected("parameter names and values")
