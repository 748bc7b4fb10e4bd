"""Figures of repeated runs."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Self


def row(name: str, values: Sequence[float], unit: str) -> str:
    """One line: minimum, median and maximum."""
    return (
        f"{name:<44} {min(values):8.2f} {statistics.median(values):8.2f} {max(values):8.2f} {unit}"
    )


def header() -> str:
    return f"{'':<44} {'min':>8} {'median':>8} {'max':>8}"


def percentile(values: Sequence[float], percent: float) -> float:
    """The smallest of the values that at least so many percent of them do not exceed."""
    if not values:
        raise ValueError("no values have no percentile")
    ordered = sorted(values)
    rank = math.ceil(percent / 100 * len(ordered))
    return ordered[max(rank, 1) - 1]


@dataclass(frozen=True, slots=True)
class Summary:
    """What is kept of many values of one unit."""

    count: int
    min: float
    p50: float
    p99: float
    max: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Self | None:
        """Sum them up; None when there are none."""
        if not values:
            return None
        return cls(
            count=len(values),
            min=min(values),
            p50=percentile(values, 50),
            p99=percentile(values, 99),
            max=max(values),
        )

    def as_json(self) -> dict[str, float]:
        return {
            name: value if name == "count" else float(f"{value:.6g}")
            for name, value in asdict(self).items()
        }
