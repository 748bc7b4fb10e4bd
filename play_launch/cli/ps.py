"""``play-launch ps``: what runs."""

from __future__ import annotations

import json
import os
import sys
from typing import Any, Final

from play_launch.cli import options
from play_launch.cli.connection import connected
from play_launch.cli.output import duration, printable, say, size, table

_TITLES: Final = ("NAME", "KIND", "STATE", "PID", "UPTIME", "RESTARTS", "CPU", "MEMORY")
_LIFECYCLE: Final = {"absent": "", "asked": "its lifecycle state is not known yet"}
"""States of managed nodes; the others are those of ROS."""


def ps(
    names: options.Names = None,
    session: options.Session = None,
    as_json: options.Json = False,
) -> None:
    """List containers, nodes and processes: state, process, restarts, CPU, memory."""
    with connected(session) as client:
        rows = client.ask("ps", {"names": names or []})
    if as_json:
        say(json.dumps(rows))
        return
    width = os.get_terminal_size(sys.stdout.fileno()).columns if sys.stdout.isatty() else None
    say("\n".join(lines(rows, width)))


def lines(rows: list[dict[str, Any]], width: int | None = None) -> list[str]:
    """Lay rows out for people; nodes stand below their container, details come last."""
    cells = [_cells(row) for row in rows]
    details = "DETAILS" if any(row[-1] for row in cells) else ""
    if any("machine" in row for row in rows):
        cells = [(row.get("machine", ""), *cell) for row, cell in zip(rows, cells, strict=True)]
        return table(("MACHINE", *_TITLES, details), cells, words=4, width=width)
    return table((*_TITLES, details), cells, words=3, width=width)


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    details = [row["reason"]]
    if managed := row.get("managed"):  # an older session sends none
        state, reason = managed["state"], managed["reason"]
        lifecycle = _LIFECYCLE.get(state, state)
        details = [f"autostart failed: {reason}" if reason else lifecycle, *details]
    indent = "  " if row["container"] else ""
    cpu, memory = row["cpu_percent"], row["memory_bytes"]
    return (
        indent + printable(row["name"]),
        row["kind"],
        row["state"],
        "-" if row["pid"] is None else str(row["pid"]),
        "-" if row["uptime_s"] is None else duration(round(row["uptime_s"] * 1e9)),
        str(row["restarts"]),
        "-" if cpu is None else f"{cpu:.1f} %",
        "-" if memory is None else size(memory),
        printable("; ".join(filter(None, details))),
    )
