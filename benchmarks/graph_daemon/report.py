"""What was measured of the two daemons, as a table and against the goals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from benchmarks.goal import Goal
from benchmarks.graph_daemon.daemons import OURS, STOCK
from benchmarks.graph_daemon.measures import Figures

Subjects = Mapping[str, Figures]

_RATIOS: Final = (
    ("burst of 32, p99", 20.0),
    ("storm, p99 of bursts of 16", 5.0),
    ("one client, median", 5.0),
    ("8 clients, calls per second", 4.0),
    ("late join, all nodes after", 1 / 0.7),
    ("storm, nodes seen late", 3.0),
    ("node list", 4.0),
)
"""Row, and by how much ours is to be better than ros2cli's."""
_FAILURES: Final = ("32 clients, failed", "burst of 32, failed", "storm, failed")
_SILENT: Final = "beside a silent client, longest"
_START: Final = "after stop, stock start"
_SHORT: Final = "address change, too few for"
_COUNTS: Final = ("failed", "fewest nodes", "seen late", "at first", "repeated")


def is_count(name: str) -> bool:
    """Whether a figure counts something; rates and times do not."""
    return name.endswith(_COUNTS)


def is_rate(name: str) -> bool:
    """Whether more is better."""
    return "per second" in name


def to_json(subjects: Subjects) -> dict[str, dict[str, float | None]]:
    """JSON knows no infinity: what never came is null."""
    return {
        subject: {name: None if math.isinf(value) else value for name, value in figures.items()}
        for subject, figures in subjects.items()
    }


def table(subjects: Subjects) -> str:
    """All figures, a column for each daemon."""
    names = list(dict.fromkeys(name for figures in subjects.values() for name in figures))
    lines = [f"{'':<36}" + "".join(f"{subject:>16}" for subject in subjects)]
    for name in names:
        cells = [written(name, figures.get(name)) for figures in subjects.values()]
        lines.append(f"{name:<36}" + "".join(f"{cell:>16}" for cell in cells))
    return "\n".join(lines)


def written(name: str, value: float | None) -> str:
    """A figure with its unit."""
    if value is None:
        return "-"
    if is_count(name):
        return "none seen" if math.isinf(value) else f"{value:.0f}"
    if is_rate(name):
        return f"{value:.0f}"
    return "never" if math.isinf(value) else f"{value * 1e3:.2f} ms"


def goals(subjects: Subjects) -> list[Goal]:
    """Ours, beside ros2cli's where that was measured."""
    ours = subjects[OURS.name]
    found = []
    if STOCK.name in subjects:
        found = [_beside(name, factor, ours, subjects[STOCK.name]) for name, factor in _RATIOS]
    found += [Goal(name, "0", f"{ours[name]:.0f}", not ours[name]) for name in _FAILURES]
    for name, limit, goal in ((_SILENT, 0.1, "100 ms"), (_START, 2.0, "2 s")):
        found.append(Goal(name, f"under {goal}", written(name, ours[name]), ours[name] < limit))
    short = ours[_SHORT]
    found.append(Goal(_SHORT, "never", written(_SHORT, short), not short))
    return found


def _beside(name: str, factor: float, ours: Figures, stock: Figures) -> Goal:
    mine, theirs = ours[name], stock[name]
    better, worse = (mine, theirs) if is_rate(name) else (theirs, mine)
    ratio = better / worse if worse else math.inf if better else 1.0
    measured = f"{written(name, mine)} beside {written(name, theirs)}"
    if math.isfinite(ratio):
        measured += f": {ratio:.1f} x"
    # No ratio exceeds that to zero.
    met = ratio >= factor or (is_count(name) and not mine)
    return Goal(name, f"{factor:.1f} x better", measured, met)
