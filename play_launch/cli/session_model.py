"""What a screen or a page shows of a session: rows with operations on them, and the log."""

from __future__ import annotations

from enum import Enum, IntEnum, StrEnum
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, Final, TypeVar

from msgspec import Struct
from rich.cells import cell_len, set_cell_size
from rich.text import Text

from play_launch.cli.output import clock, duration, printable, size
from play_launch.control.event_words import OWN_NAME
from play_launch.control.messages import UnitRow
from play_launch.control.protocol import NODE_ACTIONS
from play_launch.control.units import Health, Target, health, target_of
from play_launch.recording.console_format import CONSOLE_FORMAT, logger_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

_Choice = TypeVar("_Choice", bound=Enum)
COMPONENT: Final = "component"
TEXT_LIMIT: Final = 2000
"""Characters of a text that are kept; a line of output may have a million."""
_SELECTORS: Final = dict.fromkeys((*range(0xFE00, 0xFE10), *range(0xE0100, 0xE01F0)))
"""Variation selectors: terminals disagree about the width of the character before them."""


def clean(text: str) -> str:
    """Return foreign text as one line without control characters and direction marks.

    A tab or line end becomes a space; other characters without a shape become U+FFFD.
    """
    shown = printable(text[:TEXT_LIMIT])
    if not shown.isprintable():
        shown = "".join(
            each if each.isprintable() else " " if each.isspace() else "\N{REPLACEMENT CHARACTER}"
            for each in shown
        )
    shown = shown.translate(_SELECTORS)
    return f"{shown}…" if len(text) > TEXT_LIMIT else shown


_COLOURS: Final = {
    Health.FAILED: "bold red",
    Health.CHANGING: "yellow",
    Health.UP: "green",
    Health.INACTIVE: "dim",
}


class Order(StrEnum):
    """Sort orders of the table."""

    DECLARED = "as declared"
    NAME = "name"
    STATE = "state"
    CPU = "CPU"
    MEMORY = "memory"
    RESTARTS = "restarts"
    UPTIME = "uptime"


def following(choice: _Choice) -> _Choice:
    members = list(type(choice))
    return members[(members.index(choice) + 1) % len(members)]


_KEYS: Final[dict[Order, Callable[[UnitRow], Any]]] = {
    Order.NAME: lambda row: row.name,
    Order.STATE: lambda row: (list(Health).index(health(row)), row.state),
    Order.CPU: lambda row: None if row.cpu_percent is None else -row.cpu_percent,
    Order.MEMORY: lambda row: None if row.memory_bytes is None else -row.memory_bytes,
    Order.RESTARTS: lambda row: -row.restarts,
    Order.UPTIME: lambda row: row.uptime_s,
}
"""First: the worst state, the most memory, the latest start."""


def ordered(rows: Sequence[UnitRow], order: Order, *, is_reversed: bool = False) -> list[UnitRow]:
    """Sort rows; equal ones stay as declared, unknown values come last in either direction."""
    if order is Order.DECLARED:
        return list(reversed(rows)) if is_reversed else list(rows)
    key = _KEYS[order]
    known = [row for row in rows if key(row) is not None]
    unknown = [row for row in rows if key(row) is None]
    return [*sorted(known, key=key, reverse=is_reversed), *unknown]


def matching(rows: Iterable[UnitRow], pattern: str) -> list[UnitRow]:
    """Choose rows by name.

    Args:
        rows: All rows.
        pattern: A part of the full name, case-insensitive; with ``*``, ``?`` or ``[`` a pattern
            of all of it; with a colon, of ``/container:/node`` instead. Empty: all. The name of a
            machine chooses its rows.
    """
    wanted = pattern.strip().lower()
    is_pattern = any(character in wanted for character in "*?[")
    found: list[UnitRow] = []
    for row in rows:
        name = (str(target_of(row)) if ":" in wanted else row.name).lower()
        matches = fnmatchcase(name, wanted) if is_pattern else wanted in name
        if not wanted or matches or wanted == (row.machine or "").lower():
            found.append(row)
    return found


# Cells.

WIDTHS: Final = {"STATE": 12, "PID": 7, "UP": 7, "RST": 5, "CPU%": 6, "MEM": 6}
"""Columns of fixed width, gap included; name and last line share the rest."""
_NAME_LEAST: Final = 16
_MACHINE_MOST: Final = 12


def name_of(row: UnitRow, *, is_tree: bool) -> str:
    """Return the clean name; in the tree, nodes are indented below their container."""
    return f"{'  ' if is_tree and row.container else ''}{clean(row.name)}"


def machine_width(rows: Iterable[UnitRow]) -> int:
    """Choose the width of the column of machines; 0 for a system of one."""
    longest = max((cell_len(row.machine or "") for row in rows), default=0)
    return min(max(longest, len("MACHINE")), _MACHINE_MOST) + 1 if longest else 0


def name_width(names: Iterable[str], width: int) -> int:
    """Choose the width of the name column for a table of so many cells."""
    left = width - sum(WIDTHS.values())
    longest = max(map(cell_len, names), default=0) + 1
    return max(min(longest, int(left * 0.6)), _NAME_LEAST)


def cells_of(
    row: UnitRow, name: str, width: int, last_line: str, machine_cells: int = 0
) -> list[Text]:
    """Make the cells of a row; a name too long for its width loses its beginning."""
    if cell_len(name) >= width:
        name = f"…{set_cell_size(name[::-1], width - 2)[::-1]}"
    figures = (
        "-" if row.pid is None else str(row.pid),
        uptime(row.uptime_s),
        str(row.restarts) if row.restarts < 1000 else "999+",
        "-" if row.cpu_percent is None else f"{row.cpu_percent:.1f}"[:5].rstrip("."),
        memory(row.memory_bytes),
    )
    machine = clean(row.machine or "")[: max(machine_cells - 1, 0)]
    return [
        *([Text(machine)] if machine_cells else []),
        Text(name),
        Text(clean(row.state), _COLOURS[health(row)]),
        *(Text(figure, justify="right") for figure in figures),
        Text(f" {last_line}"),
    ]


def uptime(seconds: float | None) -> str:
    """Format a time in few characters: ``59s``, ``59m59s``, ``23h59m``, ``99d23h``."""
    if seconds is None:
        return "-"
    return duration(round(max(seconds, 0) * 1e9)).replace(" min", "m").replace(" ", "")


def memory(count: int | None) -> str:
    """Format a number of bytes in few characters: ``15.5M``, ``1.2G``."""
    return "-" if count is None else size(count).replace(" ", "").removesuffix("B")


# Operations.

OPERATIONS: Final = {
    "restart": ("r", "restarted"),
    "reload": ("r", "reloaded"),
    "stop": ("x", "stopped"),
    "unload": ("x", "unloaded"),
    "start": ("s", "started"),
    "load": ("s", "loaded"),
}
"""Key and participle of each."""


class Confirmation(Struct, frozen=True):
    """An operation and the question before it."""

    operation: str
    target: Target
    question: str


def suits(operation: str, row: UnitRow) -> bool:
    return (operation in NODE_ACTIONS) == (row.kind == COMPONENT)


def confirmation(operation: str, row: UnitRow, rows: Iterable[UnitRow]) -> Confirmation:
    """Make the question about an operation, with the nodes that it affects besides."""
    loaded = sum(row.name == each.container and each.state == "loaded" for each in rows)
    impact = ""
    if loaded and operation in {"stop", "restart"}:
        nodes = "node" if loaded == 1 else f"{loaded} nodes"
        impact = f" Its {nodes} will be {'unloaded' if operation == 'stop' else 'reloaded'}."
    question = f"{operation} {clean(row.name)}?{impact}"
    return Confirmation(operation, target_of(row), question)


# The log.

LINES_LIMIT: Final = 5000
"""Lines that are kept."""


class LeastLevel(IntEnum):
    """Least severity of the shown lines, as in ``rcl_interfaces/Log``."""

    ALL = 0
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50


class LogLine(Struct, frozen=True):
    """One line of output or of the supervisor's log."""

    stamp_ns: int
    level: int
    process: str
    """Full name of the container or process; `OWN_NAME` for the supervisor's log."""
    logger: str
    """Logger of ROS; empty if the line does not name one."""
    text: str
    """Clean, without what is in the other fields."""


def line_of(event: Mapping[str, Any]) -> LogLine:
    """Parse an event of kind output or log; raises KeyError, TypeError, ValueError."""
    text = str(event["text"])
    found = CONSOLE_FORMAT.match(text) if event["event"] == "output" else None
    logger, message = (clean(found[1]), text[found.end() :]) if found else ("", text)
    source = str(event["source"])
    return LogLine(int(event["stamp_ns"]), int(event["level"]), source, logger, clean(message))


class LogFilter(Struct, frozen=True):
    """Which lines are shown."""

    level: LeastLevel = LeastLevel.ALL
    target: Target | None = None
    """None: lines of all, the supervisor included."""

    def wants(self, line: LogLine) -> bool:
        if line.level < self.level:
            return False
        if self.target is None:
            return True
        if isinstance(self.target, str):
            return line.process == self.target
        own = logger_of(self.target.name)
        is_own = line.logger == own or line.logger.startswith(f"{own}.")
        return line.process == self.target.container and is_own


_LETTERS: Final = {10: "D", 20: "I", 30: "W", 40: "E", 50: "F"}
_STYLES: Final = {30: "yellow", 40: "bold red", 50: "bold red"}


def shown(line: LogLine) -> Text:
    """Format a line: time of day, severity, source, text."""
    source = line.logger or clean(line.process)
    text = (
        f"{clock(line.stamp_ns, '%H:%M:%S')} {_LETTERS.get(line.level, '?')} {source}: {line.text}"
    )
    return Text(text, _STYLES.get(line.level, ""))


class RowLines:
    """The last line of output of each row; `last` holds them."""

    def __init__(self) -> None:
        self._owners: dict[tuple[str, str], Target] = {}
        self.last: dict[Target, str] = {}

    def declare(self, rows: Iterable[UnitRow]) -> None:
        """Set the rows; lines of other ones are forgotten."""
        targets = set(map(target_of, rows))
        self._owners = {
            (row.container or "", logger_of(row.name)): target_of(row)
            for row in rows
            if row.kind == COMPONENT
        }
        self.last = {target: text for target, text in self.last.items() if target in targets}

    def add(self, line: LogLine) -> None:
        """Add a line; it belongs to its process and to the node of its logger or one above."""
        if line.process == OWN_NAME:
            return
        self.last[line.process] = line.text
        name = line.logger
        while name:
            owner = self._owners.get((line.process, name))
            if owner is not None:
                self.last[owner] = line.text
                return
            name = name.rpartition(".")[0]
