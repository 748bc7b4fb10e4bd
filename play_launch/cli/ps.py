"""``play-launch ps``: what runs."""

from __future__ import annotations

import json
import os
import sys
from typing import Any, Final

from play_launch.cli import options
from play_launch.cli.connection import connected
from play_launch.cli.output import duration, printable

_TITLES: Final = ("NAME", "KIND", "STATE", "PID", "UPTIME", "RESTARTS", "CPU", "MEMORY")
_LEFT: Final = 3
"""Columns of words; those of numbers are flush right."""
_SAID: Final = {"absent": "", "asked": "its lifecycle state is not known yet"}
"""States of managed nodes; the others are those of ROS."""
_GAP: Final = "  "
_LEAST: Final = 20
"""Characters of details, also where the terminal is too narrow for them."""


def ps(
    names: options.Names = None,
    session: options.Session = None,
    as_json: options.Json = False,
) -> None:
    """List containers, nodes and processes: state, process, restarts, CPU, memory."""
    with connected(session) as client:
        rows = client.ask("ps", {"names": names or []})
    if as_json:
        sys.stdout.write(f"{json.dumps(rows)}\n")
    else:
        width = os.get_terminal_size(1).columns if sys.stdout.isatty() else None
        sys.stdout.write(table(rows, width))


def table(rows: list[dict[str, Any]], width: int | None = None) -> str:
    """Lay rows out for people; nodes stand below their container.

    Details, where there are any, come last and are cut where a terminal of that width ends.
    """
    cells = [_TITLES, *(_cells(row) for row in rows)]
    details = [_details(row) for row in rows]
    details = ["DETAILS" if any(details) else "", *details]
    widths = [max(len(line[column]) for line in cells) for column in range(len(_TITLES))]
    room = None if width is None else max(width - sum(widths) - len(_GAP) * len(widths), _LEAST)
    return "".join(
        f"{_line(line, widths)}{_GAP}{_cut(last, room)}".rstrip() + "\n"
        for line, last in zip(cells, details, strict=True)
    )


def _details(row: dict[str, Any]) -> str:
    """Say why it is as it is, and how far it was brought as a managed node."""
    found = []
    if managed := row.get("managed"):  # an older session sends none
        state, reason = managed["state"], managed["reason"]
        said = f"autostart failed: {reason}" if reason else _SAID.get(state, state)
        found = [said] if said else []
    return printable("; ".join([*found, *filter(None, [row["reason"]])]), colour=False)


def _cut(text: str, room: int | None) -> str:
    return text if room is None or len(text) <= room else f"{text[: room - 3]}..."


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
    return _GAP.join(laid)
