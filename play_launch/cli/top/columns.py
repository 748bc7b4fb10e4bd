"""Which columns the table has at which width, and what stands in them."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Final

from rich.cells import cell_len

from play_launch.cli.top.cells import clean, fit, right

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from play_launch.cli.top.rows import Row


class Column(Enum):
    """What is shown of a row; the value is its title."""

    NAME = "NAME"
    STATE = "STATE"
    PID = "PID"
    UPTIME = "UP"
    RESTARTS = "RST"
    CPU = "CPU%"
    MEMORY = "MEM"
    LAST = "LAST LINE"


_WIDTHS: Final = {
    Column.STATE: 11,
    Column.PID: 7,
    Column.UPTIME: 6,
    Column.RESTARTS: 4,
    Column.CPU: 5,
    Column.MEMORY: 5,
}
"""In cells. The two others share what is left."""
_FLUSH_RIGHT: Final = frozenset(
    {Column.PID, Column.UPTIME, Column.RESTARTS, Column.CPU, Column.MEMORY}
)
_GOES_FIRST: Final = (
    Column.LAST,
    Column.RESTARTS,
    Column.UPTIME,
    Column.MEMORY,
    Column.PID,
    Column.CPU,
    Column.STATE,
)
"""What is left out where there is no room, in this order; the name stays."""
_LEAST_NAME: Final = 16
_LEAST_LAST: Final = 12
_SHARE_OF_NAME: Final = 0.6
"""The most of what is left that names get where the last line is shown, too."""
_GAP: Final = 1


def columns_at(width: int, longest_name: int) -> dict[Column, int]:
    """Choose columns and their widths, in cells, gaps of one cell not counted.

    Args:
        width: Of the table, in cells.
        longest_name: Cells of the longest name that is to be shown, indentation included.
    """
    for number in range(len(_GOES_FIRST) + 1):
        columns = [column for column in Column if column not in _GOES_FIRST[:number]]
        fixed = sum(_WIDTHS.get(column, 0) for column in columns) + _GAP * (len(columns) - 1)
        left = width - fixed
        if Column.LAST in columns:
            if left < _LEAST_NAME + _LEAST_LAST:
                continue
            most = max(_LEAST_NAME, int(left * _SHARE_OF_NAME))
            name = min(max(longest_name, len(Column.NAME.value)), most, left - _LEAST_LAST)
            widths = {**_WIDTHS, Column.NAME: name, Column.LAST: left - name}
            return {column: widths[column] for column in columns}
        if left >= _LEAST_NAME or len(columns) == 1:
            widths = {**_WIDTHS, Column.NAME: max(left, 0)}
            return {column: widths[column] for column in columns}
    raise AssertionError(width)


def name_in_table(row: Row, *, is_tree: bool) -> str:
    """Give the name of a row; where containers stand before their nodes, these are indented."""
    return f"{'  ' if is_tree and row.container else ''}{clean(row.name)}"


def titles(columns: Mapping[Column, int]) -> list[str]:
    """Give the cells of the first line."""
    return [_laid(column, column.value, cells) for column, cells in columns.items()]


def cells_of(
    row: Row, columns: Mapping[Column, int], last_line: str, *, is_tree: bool
) -> list[str]:
    """Give the cells of a row, each of the width of its column.

    Args:
        row: What it is about.
        columns: What `columns_at` gave.
        last_line: What it wrote last, clean.
        is_tree: Whether nodes are indented.
    """
    found = {
        Column.NAME: name_in_table(row, is_tree=is_tree),
        Column.LAST: last_line,
        **{column: text(row) for column, text in _TEXTS.items()},
    }
    return [_laid(column, found[column], cells) for column, cells in columns.items()]


def longest_name(rows: list[Row], *, is_tree: bool) -> int:
    """Measure names, in cells."""
    return max((cell_len(name_in_table(row, is_tree=is_tree)) for row in rows), default=0)


def uptime(seconds: float | None) -> str:
    """Write a time in at most six characters: ``59s``, ``59m59s``, ``23h59m``, ``99d23h``."""
    if seconds is None:
        return "-"
    whole = max(int(seconds), 0)
    if whole < 60:
        return f"{whole}s"
    if whole < 3600:
        return f"{whole // 60}m{whole % 60:02}s"
    if whole < 86400:
        return f"{whole // 3600}h{whole // 60 % 60:02}m"
    if whole < 100 * 86400:
        return f"{whole // 86400}d{whole // 3600 % 24:02}h"
    return f"{min(whole // 86400, 99999)}d"


def memory(count: int | None) -> str:
    """Write a number of bytes in at most five characters, in powers of ten: ``15.5M``, ``1.2G``."""
    if count is None:
        return "-"
    for unit, factor in (("T", 10**12), ("G", 10**9), ("M", 10**6), ("k", 10**3)):
        if count >= factor * 0.9995:
            value = min(count / factor, 9999)
            return f"{value:.1f}{unit}" if value < 99.95 else f"{value:.0f}{unit}"
    return str(max(count, 0))


def _cpu(percent: float | None) -> str:
    if percent is None:
        return "-"
    return f"{percent:.1f}" if percent < 999.5 else f"{min(percent, 99999):.0f}"


_TEXTS: Final[dict[Column, Callable[[Row], str]]] = {
    Column.STATE: lambda row: clean(row.state),
    Column.PID: lambda row: "-" if row.pid is None else str(row.pid),
    Column.UPTIME: lambda row: uptime(row.uptime_s),
    Column.RESTARTS: lambda row: str(row.restarts) if row.restarts < 1000 else "999+",
    Column.CPU: lambda row: _cpu(row.cpu_percent),
    Column.MEMORY: lambda row: memory(row.memory_bytes),
}


def _laid(column: Column, text: str, cells: int) -> str:
    if column in _FLUSH_RIGHT:
        return right(text, cells)
    return fit(text, cells, keeps_end=column is Column.NAME)
