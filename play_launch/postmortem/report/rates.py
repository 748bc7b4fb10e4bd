"""How many messages of each topic came when."""

from __future__ import annotations

from array import array
from typing import Final

from msgspec import Struct, field

PARTS: Final = 256
"""Into so many parts the time is divided, or up to half as many."""


class Rates(Struct):
    """Counts of each topic in equal parts of the time; the parts double when they are used up."""

    width: float = 250.0
    """Milliseconds of one part."""
    counts: dict[str, array[int]] = field(default_factory=dict)

    def add(self, topic: str, at: float) -> None:
        """Count one message, ``at`` milliseconds since the start."""
        while at >= self.width * PARTS:
            self.width *= 2
            self.counts = {name: _halved(each) for name, each in self.counts.items()}
        counts = self.counts.get(topic)
        if counts is None:
            counts = self.counts[topic] = array("I", bytes(4 * PARTS))
        counts[int(at / self.width)] += 1


def _halved(counts: array[int]) -> array[int]:
    pairs = array("I", [counts[i] + counts[i + 1] for i in range(0, PARTS, 2)])
    return pairs + array("I", bytes(2 * PARTS))
