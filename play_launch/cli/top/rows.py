"""The rows of the table: what is known of each, which are shown, and in which order."""

from __future__ import annotations

from enum import Enum, StrEnum, auto
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import msgspec
from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

COMPONENT: Final = "component"


class Subject(NamedTuple):
    """What a row is about, the same for as long as it is declared."""

    container: str | None
    """Full name of the container of a composable node, else None."""
    name: str

    @property
    def target(self) -> str:
        """As operations name it without doubt."""
        return f"{self.container}:{self.name}" if self.container else self.name


class Row(Struct, frozen=True):
    """One object of ``ps``, as docs/control.md describes it, as far as it is shown."""

    name: str
    kind: str
    state: str
    container: str | None = None
    reason: str = ""
    pid: int | None = None
    restarts: int = 0
    uptime_s: float | None = None
    exit_code: int | None = None
    signal: int | None = None
    cpu_percent: float | None = None
    memory_bytes: int | None = None

    @property
    def subject(self) -> Subject:
        """What it is about."""
        return Subject(self.container, self.name)


def rows_of(result: Any) -> list[Row]:
    """Read the answer to ``ps``.

    Raises:
        ValueError: When it is something else.
    """
    return msgspec.convert(result, list[Row], strict=False)


class Mood(Enum):
    """What a state says to a person at a glance."""

    BAD = auto()
    """Something failed."""
    BUSY = auto()
    """On its way to another state."""
    GOOD = auto()
    REST = auto()
    """It does not run, and need not."""


_MOODS: Final = {
    "running": Mood.GOOD,
    "loaded": Mood.GOOD,
    "stopped": Mood.REST,
    "unloaded": Mood.REST,
    "exited": Mood.REST,
    "gave up": Mood.BAD,
    "load failed": Mood.BAD,
    "crashed": Mood.BAD,
    "lost": Mood.BAD,
    "backoff": Mood.BAD,
    "killing": Mood.BAD,
}


def mood(row: Row) -> Mood:
    """Judge a row; a state that nobody knows here is on its way."""
    has_failed = row.state == "exited" and (row.exit_code or row.signal)
    return Mood.BAD if has_failed else _MOODS.get(row.state, Mood.BUSY)


class Order(StrEnum):
    """What rows are sorted by."""

    DECLARED = "as declared"
    NAME = "name"
    STATE = "state"
    CPU = "CPU"
    MEMORY = "memory"
    RESTARTS = "restarts"
    UPTIME = "uptime"

    def next(self) -> Order:
        """The one that comes after it, in a circle."""
        orders = list(Order)
        return orders[(orders.index(self) + 1) % len(orders)]


_WORST_FIRST: Final = {mood: place for place, mood in enumerate(Mood)}
_KEYS: Final[dict[Order, Callable[[Row], Any]]] = {
    Order.NAME: lambda row: row.name,
    Order.STATE: lambda row: (_WORST_FIRST[mood(row)], row.state),
    Order.CPU: lambda row: None if row.cpu_percent is None else -row.cpu_percent,
    Order.MEMORY: lambda row: None if row.memory_bytes is None else -row.memory_bytes,
    Order.RESTARTS: lambda row: -row.restarts,
    Order.UPTIME: lambda row: row.uptime_s,
}
"""What is looked for first comes first: the worst state, the most memory, what started last."""


def ordered(rows: Sequence[Row], order: Order, *, is_reversed: bool = False) -> list[Row]:
    """Sort rows; equal ones stay as declared, and what is not known comes last in any case."""
    if order is Order.DECLARED:
        return list(reversed(rows)) if is_reversed else list(rows)
    key = _KEYS[order]
    known = [row for row in rows if key(row) is not None]
    unknown = [row for row in rows if key(row) is None]
    return [*sorted(known, key=key, reverse=is_reversed), *unknown]


def matching(rows: Iterable[Row], pattern: str) -> list[Row]:
    """Choose rows by name.

    Args:
        rows: From these.
        pattern: A part of the full name, capital or small; with ``*``, ``?`` or ``[`` a pattern
            over it; with a colon, of ``/container:/node`` instead. Empty: all.
    """
    wanted = pattern.strip().lower()
    if not wanted:
        return list(rows)
    is_pattern = any(character in wanted for character in "*?[")
    found: list[Row] = []
    for row in rows:
        name = (row.subject.target if ":" in wanted else row.name).lower()
        if fnmatchcase(name, wanted) if is_pattern else wanted in name:
            found.append(row)
    return found


def place_of(subject: Subject | None, rows: Sequence[Row], before: int) -> int:
    """Find the row that stays selected: the same subject, else what stands in its place by now."""
    for place, row in enumerate(rows):
        if row.subject == subject:
            return place
    return max(0, min(before, len(rows) - 1))


def counted(rows: Sequence[Row]) -> str:
    """Sum up how the system is: ``7 of 9 up, 1 failed, 1 stopped``."""
    moods = [mood(row) for row in rows]
    words = {Mood.BAD: "failed", Mood.BUSY: "under way", Mood.REST: "at rest"}
    others = [f"{moods.count(each)} {word}" for each, word in words.items() if each in moods]
    return ", ".join([f"{moods.count(Mood.GOOD)} of {len(rows)} up", *others])
