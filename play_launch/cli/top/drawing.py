"""What stands on the screen, as lines of pieces of text; nothing here knows a terminal."""

from __future__ import annotations

from enum import Enum, auto
from typing import TYPE_CHECKING, Final

from rich.cells import cell_len

from play_launch.cli.top.cells import clean, fit
from play_launch.cli.top.columns import Column, cells_of, columns_at, longest_name, titles, uptime
from play_launch.cli.top.log_lines import MOST_LINES, Level, page
from play_launch.cli.top.operations import offered
from play_launch.cli.top.rows import Mood, Order, counted, mood

if TYPE_CHECKING:
    from play_launch.cli.top.model import Model
    from play_launch.cli.top.rows import Row


class Look(Enum):
    """How a piece of text looks."""

    PLAIN = auto()
    TITLE = auto()
    """Of the pane that the arrow keys are for."""
    QUIET_TITLE = auto()
    STRONG = auto()
    QUIET = auto()
    GOOD = auto()
    BUSY = auto()
    BAD = auto()


Piece = tuple[str, Look]
Line = list[Piece]

_OF_MOODS: Final = {
    Mood.BAD: Look.BAD,
    Mood.BUSY: Look.BUSY,
    Mood.GOOD: Look.GOOD,
    Mood.REST: Look.QUIET,
}
_LATE: Final = 2.0
"""Seconds without an answer that are shown."""
KEYS: Final = (
    ("Up Down PgUp PgDn Home End", "select a row, or scroll the log"),
    ("Tab", "choose between the table and the log for these keys"),
    ("/", "show only rows with a name: a part of it, or a pattern"),
    ("o, O", "sort by something else; turn the order around"),
    ("Enter", "show only lines of the selected row, or of all again"),
    ("l", "show only lines of a level and above, up to fatal"),
    ("Esc", "show all rows and the lines of all of them again"),
    ("r", "restart a container or process, reload a composable node"),
    ("x", "stop a container or process, unload a composable node"),
    ("s", "start a container or process, load a composable node"),
    ("q, Ctrl-C", "leave; the session goes on"),
)
"""What the help shows."""


def head(model: Model, width: int) -> Line:
    """Draw the line about the session."""
    hello = model.hello
    name = f"{clean(hello.name)} (pid {hello.pid})"
    if model.silence >= _LATE:
        return _cut(
            [(name, Look.STRONG), (f"  no answer for {model.silence:.0f} s", Look.BAD)], width
        )
    if not model.has_rows:
        return _cut([(name, Look.STRONG), ("  asking", Look.QUIET)], width)
    only = f"; {len(model.shown)} with {clean(model.pattern)!r}" if model.pattern else ""
    bad = any(mood(row) is Mood.BAD for row in model.rows)
    return _cut(
        [
            (name, Look.STRONG),
            (f"  up {uptime(model.age_s)}  ", Look.PLAIN),
            (counted(model.rows), Look.BAD if bad else Look.PLAIN),
            (only, Look.STRONG),
            (_sorted(model), Look.STRONG),
        ],
        width,
    )


def first_shown(first: int, place: int, height: int, count: int) -> int:
    """Scroll a list as little as needed for a place in it to be seen.

    Args:
        first: What has been at the top.
        place: What is to be seen.
        height: Rows that are seen at once.
        count: Of the list.
    """
    first = min(first, place, max(count - height, 0))
    return max(first, place - height + 1, 0)


def table(model: Model, width: int, height: int, first: int, *, has_focus: bool) -> list[Line]:
    """Draw the titles and the rows from the first one on; the selected one is the caller's."""
    columns = columns_at(width, longest_name(model.shown, is_tree=model.is_tree))
    look = Look.TITLE if has_focus else Look.QUIET_TITLE
    lines: list[Line] = [_cut([(" ".join(titles(columns)), look)], width, look)]
    if model.has_rows and not model.shown:
        nothing = (
            f"no name has {clean(model.pattern)!r} in it" if model.rows else "nothing is declared"
        )
        lines.append(_cut([(nothing, Look.QUIET)], width))
    for row in model.shown[first : first + max(height - 1, 0)]:
        last = model.last.of(row.subject)
        cells = cells_of(row, columns, last, is_tree=model.is_tree)
        pieces: Line = []
        for column, cell in zip(columns, cells, strict=True):
            shown_as = _OF_MOODS[mood(row)] if column is Column.STATE else Look.PLAIN
            pieces += [(cell, shown_as), (" ", Look.PLAIN)]
        lines.append(_cut(pieces[:-1], width))
    return lines[:height]


def detail(model: Model, width: int) -> Line:
    """Draw the line about the selected row: its full name, and why it is as it is."""
    row = model.selected
    if row is None:
        return _cut([], width)
    facts = [clean(row.subject.target), clean(row.kind), *_end_of(row), clean(row.reason)]
    return _cut([(", ".join(fact for fact in facts if fact), Look.QUIET)], width)


def log_title(model: Model, width: int, *, has_focus: bool) -> Line:
    """Draw the line above the log: what is chosen, and how much is not there any more."""
    look = Look.TITLE if has_focus else Look.QUIET_TITLE
    chosen = model.filter
    parts = ["LOG", "of all" if chosen.subject is None else f"of {clean(chosen.subject.name)}"]
    if chosen.level is not Level.ALL:
        parts.append(f"{chosen.level.name.lower()} and above")
    if model.log_end is not None:
        parts.append(f"{model.buffer.after(model.log_end, chosen)} lines below")
    if model.buffer.gone:
        parts.append(f"{model.buffer.gone} older than the last {MOST_LINES:,} kept")
    if model.buffer.missed:
        parts.append(f"{model.buffer.missed} missed")
    return _cut([(", ".join(parts).replace(", ", " ", 1), look)], width, look)


def log(model: Model, width: int, height: int) -> list[Line]:
    """Draw the lines of the log; the newest stands at the bottom."""
    buffer = model.buffer
    # Lines that are being read give way, too.
    end = buffer.end if model.log_end is None else max(model.log_end, buffer.gone + height)
    found = page(model.buffer, model.filter, end, width, height)
    looks = {30: Look.BUSY, 40: Look.BAD, 50: Look.BAD}
    return [_cut([(text, looks.get(line.level, Look.PLAIN))], width) for line, text in found]


def foot(model: Model, width: int) -> Line:
    """Draw the last line: what came of something, else which keys there are for the row."""
    if model.is_typing:
        hint = "  Enter done  Esc all"
        room = max(width - len(hint) - 8, 1)
        typed = clean(model.pattern)
        typed = fit(typed, room, keeps_end=True) if cell_len(typed) > room else typed
        return _cut(
            [("names: ", Look.STRONG), (f"{typed}_", Look.PLAIN), (hint, Look.QUIET)], width
        )
    if model.message:
        return _cut([(model.message, Look.STRONG)], width)
    keys = [
        *offered(model.selected, model.by_subject),
        ("?", "help"),
        ("q", "quit"),
        ("/", "filter"),
        ("Enter", "its log"),
        ("l", "level"),
        ("o", "sort"),
    ]
    pieces: Line = []
    for key, does in keys:
        pieces += [(key, Look.STRONG), (f" {does}  ", Look.PLAIN)]
    return _cut(pieces, width)


def _sorted(model: Model) -> str:
    if model.is_tree:
        return ""
    by = model.order.value if model.order is Order.DECLARED else f"by {model.order}"
    return f"; {by}{', reversed' if model.is_reversed else ''}"


def _end_of(row: Row) -> list[str]:
    if row.signal:
        return [f"ended by signal {row.signal}"]
    return [f"exit code {row.exit_code}"] if row.exit_code else []


def _cut(pieces: Line, width: int, rest: Look = Look.PLAIN) -> Line:
    """Cut or fill a line to its width."""
    line: Line = []
    left = width
    for text, look in pieces:
        size = cell_len(text)
        line.append((text if size <= left else fit(text, left), look))
        left -= min(size, left)
        if not left:
            return line
    return [*line, (" " * left, rest)]
