"""Problems of a configuration, and their locations."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace

if TYPE_CHECKING:
    from collections.abc import Iterator

KNOWN = "; known here: "
"""What is between a mistake and the list of what could stand there."""
_LONGEST_EXCERPT = 60
_MOST_SHOWN = 50
_PLAIN_KEY = re.compile(r"[\w\-./~*]+")


class Location(Struct, frozen=True):
    """A character in a file: `line` and `column` count from 1, columns in characters.

    `included_from` is where another file includes this one; None in the file that was given.
    """

    file: str
    line: int
    column: int
    included_from: Location | None = None

    @property
    def inclusions(self) -> tuple[str, ...]:
        above = self.included_from
        return () if above is None else (str(above), *above.inclusions)

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"


class Problem(Struct, frozen=True, order=True):
    """One mistake in a configuration.

    `path` leads to the value, for example `containers[0].composable_nodes[1].plugin`, or is
    `(file)`, `(yaml)` or `(top level)` for a mistake that belongs to no key. `included_from` holds
    the locations of the inclusions that led to the file, the nearest first.
    """

    file: str
    line: int
    column: int
    path: str
    message: str
    included_from: tuple[str, ...] = ()

    def __str__(self) -> str:
        # A file may be called anything, and a report has one line for each problem.
        text = f"{self.file}:{self.line}:{self.column}: {self.path}: {self.message}"
        if self.included_from:
            text += f" (included from {', from '.join(self.included_from)})"
        return _on_one_line(text)

    @classmethod
    def at(cls, location: Location, path: str, message: str) -> Problem:
        file, line, column = location.file, location.line, location.column
        return cls(file, line, column, path, message, location.inclusions)


class ConfigError(Exception):
    """A configuration that cannot be used, with every problem found.

    Its text is one line for each problem: `file:line:column: path: message`.
    """

    def __init__(self, problems: tuple[Problem, ...]) -> None:
        super().__init__(problems)
        self.problems = problems

    def __str__(self) -> str:
        return "\n".join(str(problem) for problem in self.problems)

    def for_people(self) -> str:
        """Return the first problems, each list of choices once, and how many more there are."""
        lines = []
        listed = set()
        for problem in self.problems[:_MOST_SHOWN]:
            mistake, _, choices = problem.message.partition(KNOWN)
            lines.append(str(replace(problem, message=mistake) if choices in listed else problem))
            listed.add(choices)
        if left := len(self.problems) - len(lines):
            lines.append(f"and {left:,} more; play-launch check --json lists them all")
        return "\n".join(lines)


class Report:
    """The problems found so far, each once; one belongs to one call of `load_config`."""

    def __init__(self) -> None:
        self._problems: dict[Problem, None] = {}
        self.missing_packages: dict[Location, Problem] = {}
        """Of values that are read as they are, and matter only where their machine is this one."""
        self._missing_here: dict[tuple[str, int, int], Problem] = {}

    def __len__(self) -> int:
        return len(self._problems)

    def __iter__(self) -> Iterator[Problem]:
        return iter(self._problems)

    def add(self, location: Location, path: str, message: str) -> None:
        self._problems[Problem.at(location, path, message)] = None

    def add_missing(self, problem: Problem) -> None:
        """Add the problem of a missing package; no other one of the same value is reported."""
        self._problems[problem] = None
        self._missing_here[problem.file, problem.line, problem.column] = problem

    def raise_if_any(self, first_file: str) -> None:
        """Raise ConfigError if anything was found: `first_file` first, then by location."""
        if self._problems:
            missing = self._missing_here
            kept = [
                each
                for each in self._problems
                if missing.get((each.file, each.line, each.column), each) == each
            ]
            ordered = sorted(kept, key=lambda found: (found.file != first_file, found))
            raise ConfigError(tuple(ordered))


def excerpt(text: str) -> str:
    """Quote `text` for a message: on one line, printable, and shortened when it is long."""
    if len(text) > _LONGEST_EXCERPT:
        text = text[: _LONGEST_EXCERPT - 1] + "…"
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{_on_one_line(escaped)}"'


def join_path(path: str, key: str) -> str:
    """Append the mapping key `key` to `path`, which stays on one line and can be read back."""
    written = key[:_LONGEST_EXCERPT] if _PLAIN_KEY.fullmatch(key) else excerpt(key)
    return f"{path}.{written}" if path else written


def _on_one_line(text: str) -> str:
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode("ascii") for one in text
    )
