"""``play-launch ps``: what runs."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any, Final

from play_launch.cli.operate import OK, add_names
from play_launch.cli.show.durations import duration
from play_launch.cli.show.terminal import printable

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from play_launch.control.client import ControlClient

_TITLES: Final = ("NAME", "KIND", "STATE", "PID", "UPTIME", "RESTARTS", "CPU", "MEMORY")
_LEFT: Final = 3
"""Columns of words; those of numbers are flush right."""


def add_arguments(parser: ArgumentParser, verb: str) -> None:  # noqa: ARG001 - as for all verbs
    """Declare what it takes."""
    add_names(parser, "only these", optional=True)


def run(client: ControlClient, options: Namespace) -> int:
    """Print the table, or its rows as JSON."""
    rows = client.ask("ps", {"names": options.names})
    if options.json:
        sys.stdout.write(f"{json.dumps(rows)}\n")
    else:
        sys.stdout.write(table(rows))
    return OK


def table(rows: list[dict[str, Any]]) -> str:
    """Lay rows out for people; nodes stand below their container."""
    cells = [_TITLES, *(_cells(row) for row in rows)]
    widths = [max(len(line[column]) for line in cells) for column in range(len(_TITLES))]
    return "".join(f"{_line(line, widths)}\n" for line in cells)


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    indent = "  " if row["container"] else ""
    cpu, memory = row["cpu_percent"], row["memory_bytes"]
    return (
        indent + printable(row["name"], colour=False),
        row["kind"],
        row["state"],
        "-" if row["pid"] is None else str(row["pid"]),
        "-" if row["uptime_s"] is None else duration(round(row["uptime_s"] * 1e9)),
        str(row["restarts"]),
        "-" if cpu is None else f"{cpu:.1f} %",
        "-" if memory is None else f"{memory / 1e6:,.1f} MB",
    )


def _line(cells: tuple[str, ...], widths: list[int]) -> str:
    laid = [
        cell.ljust(width) if column < _LEFT else cell.rjust(width)
        for column, (cell, width) in enumerate(zip(cells, widths, strict=True))
    ]
    return "  ".join(laid).rstrip()
