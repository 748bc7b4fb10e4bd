"""The rows of the timeline: containers, composable nodes and ordinary processes."""

from __future__ import annotations

from typing import Final

from msgspec import Struct

from play_launch.postmortem.report.text import shown
from play_launch.supervisor.events import SubjectKind

MOST: Final = 60_000
"""Rows that a page has; a number of 16 bits names one."""
NO_ROW: Final = 0xFFFF
"""In the place of a row: the supervisor itself, or a unit beyond `MOST`."""


class Row(Struct, frozen=True):
    """One thing whose life the timeline shows."""

    kind: str
    """``node``, ``container`` or ``process``."""
    name: str
    container: str
    """Of a node; else empty."""


class Rows:
    """Rows by kind and key (as in the changes of state), in the order in which they were met."""

    def __init__(self) -> None:
        """Begin without any."""
        self.rows: list[Row] = []
        self._numbers: dict[tuple[SubjectKind, str], int] = {}
        self._of_logger: dict[tuple[str, str], int] = {}

    def number(self, kind: SubjectKind, key: str) -> int:
        """Give the number of a row; it is made when it is new."""
        number = self._numbers.get((kind, key))
        if number is None:
            number = self._numbers[kind, key] = self._add(kind, key)
        return number

    def of_name(self, name: str) -> int:
        """Give the row of a container, or of an ordinary process where none has that name."""
        container = self._numbers.get((SubjectKind.CONTAINER, name))
        return self.number(SubjectKind.PROCESS, name) if container is None else container

    def is_container(self, number: int) -> bool:
        """Whether that row is a container's."""
        return number < len(self.rows) and self.rows[number].kind == "container"

    def of_logger(self, process: str, logger: str) -> int:
        """Give the row that a line belongs to: of the node that a logger is named after.

        A logger's name is that of its node with dots for slashes, perhaps with more behind it.
        """
        while logger:
            if (known := self._of_logger.get((process, logger))) is not None:
                return known
            logger = logger.rpartition(".")[0]
        return self.of_name(process)

    def has_logger(self, process: str, logger: str) -> bool:
        """Whether that is a node's own logger."""
        return (process, logger) in self._of_logger

    def _add(self, kind: SubjectKind, key: str) -> int:
        number = len(self.rows)
        if number >= MOST:
            return NO_ROW
        container, name = "", key
        if kind is SubjectKind.NODE:
            container, _, name = key.partition(":")
            self._of_logger[container, name.removeprefix("/").replace("/", ".")] = number
        self.rows.append(Row(kind.name.lower(), shown(name), shown(container)))
        return number
