"""Columns of numbers as text that a page can hold, and that its script unpacks.

Times and values change little from one to the next, so differences are stored, byte by byte apart
(all lowest bytes first), compressed by zlib, in base64. A browser has `DecompressionStream` for it.
"""

from __future__ import annotations

import base64
import sys
import zlib
from array import array
from math import isfinite
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

MISSING: Final = 0xFFFF
"""In the place of a value that is not known."""
_STEPS: Final = 0xFFFE
_HALF: Final = 1 << 31
_LATEST: Final = _HALF - 1
"""Milliseconds; 24 days."""


class Quantised(NamedTuple):
    """A column in 65,535 steps from the lowest to the highest of its values."""

    low: float
    high: float
    steps: array[int]


def packed(data: bytes) -> str:
    """Compress bytes into text."""
    return base64.b64encode(zlib.compress(data, 6)).decode("ascii")


def quantised(values: Sequence[float]) -> Quantised:
    """Put values into steps; what is not finite becomes `MISSING`."""
    known = [value for value in values if isfinite(value)]
    low, high = (min(known), max(known)) if known else (0.0, 0.0)
    scale = _STEPS / (high - low) if high > low else 0.0
    if not isfinite(scale):
        scale = 0.0
    if len(known) == len(values):
        steps = array("H", [round((value - low) * scale) for value in values])
    else:
        steps = array(
            "H",
            [round((value - low) * scale) if isfinite(value) else MISSING for value in values],
        )
    return Quantised(low, high, steps)


def value_planes(columns: Iterable[array[int]]) -> bytes:
    """Give 16-bit columns one behind the other: differences, then low bytes before high bytes."""
    differences = array("H")
    before = 0
    for column in columns:
        for step in column:
            differences.append((step - before) & 0xFFFF)
            before = step
    return _planes(differences)


def time_planes(columns: Iterable[Sequence[float]]) -> bytes:
    """Give times in milliseconds, one column behind the other.

    Stored is by how much the distance from one to the next changes (0 for a steady period), in 32
    bits and zigzag: 0, -1, 1, -2, ... Each column begins anew. Times beyond 24 days stay there.
    """
    changes = array("I")
    for column in columns:
        before = distance = 0
        for at in column:
            now = min(max(round(at), 0), _LATEST)
            # Modulo 2**32, and from -2**31 on; the times themselves fit, so nothing is lost.
            change = ((now - before - distance + _HALF) & 0xFFFF_FFFF) - _HALF
            distance, before = now - before, now
            changes.append(change << 1 if change >= 0 else ~(change << 1))
    return _planes(changes)


def _planes(numbers: array[int]) -> bytes:
    if sys.byteorder == "big":
        numbers.byteswap()
    raw, size = numbers.tobytes(), numbers.itemsize
    return b"".join(raw[plane::size] for plane in range(size))
