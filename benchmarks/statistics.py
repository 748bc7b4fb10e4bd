"""Figures of repeated runs."""

from __future__ import annotations

import statistics
from collections.abc import Sequence


def row(name: str, values: Sequence[float], unit: str) -> str:
    """One line: minimum, median and maximum."""
    return (
        f"{name:<44} {min(values):8.2f} {statistics.median(values):8.2f} {max(values):8.2f} {unit}"
    )


def header() -> str:
    return f"{'':<44} {'min':>8} {'median':>8} {'max':>8}"
