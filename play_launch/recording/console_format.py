"""What a line of console output tells: its severity, and the node that logged it."""

from __future__ import annotations

import logging
import re
from typing import TYPE_CHECKING, Final

from play_launch.supervisor.events import OutputLine, Stream

if TYPE_CHECKING:
    from collections.abc import Iterator

DEBUG: Final = 10
INFO: Final = 20
WARN: Final = 30
ERROR: Final = 40
FATAL: Final = 50

_LEVELS: Final = logging.getLevelNamesMapping()
"""ROS has Python's levels, and names of its own for some that Python knows too."""
_SEVERITY: Final = re.compile(r"(?:\x1b\[[0-9;]*m)*\[\s*([A-Z]{4,8})\s*\](?!\w)")
CONSOLE_FORMAT: Final = re.compile(r"^\S*\[[A-Z ]+\](?: \[[^\]]*\])? \[([^\]]+)\]: ")
"""ROS's console format: severity, time, and the logger as the only group."""


def line_level(line: OutputLine) -> int:
    """The level (as in ``rcl_interfaces/Log``) at which a process wrote a line.

    ROS's console format begins with ``[WARN] [time] [logger]: ``, perhaps after a colour; a line
    without a severity counts as INFO on stdout and as WARN on stderr.
    """
    text = line.text
    if text[:1] in ("[", "\x1b"):
        match = _SEVERITY.match(text)
        if match:
            level = _LEVELS.get(match[1])
            if level is not None:
                return level
    return INFO if line.stream is Stream.STDOUT else WARN


def logger_of(node: str) -> str:
    """Return the name of a node's logger in ROS."""
    return node.lstrip("/").replace("/", ".")


def loggers_in(text: str) -> Iterator[str]:
    """Give the logger that a line names, and those above it; none where it names none."""
    found = CONSOLE_FORMAT.match(text)
    name = found[1] if found else ""
    while name:
        yield name
        name = name.rpartition(".")[0]
