"""What processes and the machine used, and how many messages came, as numbers over time.

A page holds columns of numbers as text that its script unpacks. Times and values change little from
one to the next, so differences are stored, byte by byte apart (all lowest bytes first), compressed
by zlib, in base64. A browser has `DecompressionStream` for it.
"""

from __future__ import annotations

import base64
import sys
import zlib
from array import array
from itertools import chain
from math import isfinite, isnan, nan
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from msgspec import Struct, field

from play_launch.supervisor.events import MemoryKind

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

MOST: Final = 16_384
"""Samples of one thing, a multiple of four; of more, lowest and highest of each few are kept."""
PARTS: Final = 256
"""Into so many parts the time is divided, or up to half as many."""
PROCESS_COLUMNS: Final = ("cpu", "memory")
SYSTEM_COLUMNS: Final = (
    *("cpu", "memory", "cpu_pressure", "memory_pressure", "io_pressure", "steal"),
)
"""All in percent; see `play_launch.supervisor.events.SystemSample`."""
MISSING: Final = 0xFFFF
"""In the place of a value that is not known."""
_STEPS: Final = 0xFFFE
_HALF: Final = 1 << 31
_LATEST: Final = _HALF - 1
"""Milliseconds; 24 days."""


class Series(Struct):
    """Columns that have their times in common: milliseconds since the start, never falling."""

    columns: tuple[array[float], ...]
    times: array[float] = field(default_factory=lambda: array("d"))
    row: int = 0
    """Of the timeline."""
    is_shared: bool = False
    """Whether its memory is that of its container."""
    _last: float = 0.0
    _width: int = 1
    """Two times so many samples become two."""
    _waiting: list[tuple[float, tuple[float, ...]]] = field(default_factory=list)

    def add(self, at: float, values: tuple[float, ...]) -> None:
        at = max(at, self._last)
        self._last = at
        if self._width == 1:
            self._append(at, values)
        else:
            self._waiting.append((at, values))
            if len(self._waiting) == 2 * self._width:
                self._append_extremes()
        if len(self.times) >= MOST:
            self._thin_out()

    def extend(self, times: Sequence[float], columns: Sequence[Sequence[float]]) -> None:
        """Take many samples; their times do not fall."""
        if self._width > 1 or len(self.times) + len(times) >= MOST or times[0] < self._last:
            for at, *sample in zip(times, *columns, strict=True):
                self.add(at, tuple(sample))
            return
        self._last = times[-1]
        self.times.extend(times)
        for column, values in zip(self.columns, columns, strict=True):
            column.extend(values)

    def finish(self) -> None:
        """Take what is waiting for more, as it is."""
        for at, values in self._waiting:
            self._append(at, values)
        self._waiting.clear()

    def _append(self, at: float, values: tuple[float, ...]) -> None:
        self.times.append(at)
        for column, value in zip(self.columns, values, strict=True):
            column.append(value)

    def _append_extremes(self) -> None:
        waiting, self._waiting = self._waiting, []
        low_high = [
            _extremes(column) for column in zip(*(each[1] for each in waiting), strict=True)
        ]
        first, second = zip(*low_high, strict=True)
        self._append(waiting[0][0], first)
        self._append(waiting[self._width][0], second)

    def _thin_out(self) -> None:
        # Only when nothing waits, and `MOST` can be divided by four.
        self._width *= 2
        self.times = self.times[::2]
        for column in self.columns:
            pairs = [_extremes(column[i : i + 4]) for i in range(0, len(column), 4)]
            column[:] = array("d", [value for pair in pairs for value in pair])


def _extremes(values: Sequence[float]) -> tuple[float, float]:
    """Give the lowest and the highest, that which came first before the other."""
    known = [value for value in values if not isnan(value)]
    if not known:
        return nan, nan
    low, high = min(known), max(known)
    return (low, high) if known.index(low) < known.index(high) else (high, low)


class Usage(Struct):
    """Series of each row that was sampled, and of the machine."""

    of_rows: dict[int, Series] = field(default_factory=dict)
    system: Series = field(default_factory=lambda: _series(SYSTEM_COLUMNS))

    def finish(self) -> None:
        """Take what waits for more: no sample comes any more."""
        for series in (*self.of_rows.values(), self.system):
            series.finish()

    def process(
        self, row: int, kind: int, times: Sequence[float], *columns: Sequence[float]
    ) -> None:
        """Take samples of a process: percent of a core, and bytes of this ``kind`` of memory."""
        series = self.of_rows.get(row)
        if series is None:
            series = self.of_rows[row] = _series(PROCESS_COLUMNS)
            series.row = row
        series.is_shared = kind == MemoryKind.SHARED
        series.extend(times, columns)

    def machine(self, at: float, sample: Mapping[str, Any]) -> None:
        total = sample["memory_total"]
        used = 100 * (total - sample["memory_available"]) / total if total else nan
        pressures = (sample[f"{name}_some_avg10"] for name in ("cpu", "memory", "io"))
        self.system.add(at, (sample["cpu_percent"], used, *pressures, sample["steal_percent"]))


def _series(columns: tuple[str, ...]) -> Series:
    return Series(columns=tuple(array("d") for _ in columns))


class Rates(Struct):
    """Counts of each topic in equal parts of the time; the parts double when they are used up."""

    width: float = 250.0
    """Milliseconds of one part."""
    counts: dict[str, array[int]] = field(default_factory=dict)

    def add(self, topic: str, at: float, count: int = 1) -> None:
        """Count messages, ``at`` milliseconds since the start."""
        while at >= self.width * PARTS:
            self.width *= 2
            self.counts = {name: _halved(each) for name, each in self.counts.items()}
        counts = self.counts.get(topic)
        if counts is None:
            counts = self.counts[topic] = array("I", bytes(4 * PARTS))
        counts[int(at / self.width)] += count


def _halved(counts: array[int]) -> array[int]:
    pairs = array("I", [counts[i] + counts[i + 1] for i in range(0, PARTS, 2)])
    return pairs + array("I", bytes(2 * PARTS))


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
    steps = array("H", chain.from_iterable(columns))
    before = chain((0,), steps)
    return _planes(array("H", [(b - a) & 0xFFFF for a, b in zip(before, steps, strict=False)]))


def time_planes(columns: Iterable[Sequence[float]]) -> bytes:
    """Give times in milliseconds, one column behind the other.

    Stored is by how much the distance from one to the next changes (0 for a steady period), in 32
    bits and zigzag: 0, -1, 1, -2, ... Each column begins anew. Times beyond 24 days stay there.
    """
    changes = array("I")
    # Many units have the same times.
    known: dict[bytes, array[int]] = {}
    for column in columns:
        times = array("I", [min(max(round(at), 0), _LATEST) for at in column])
        found = known.get(times.tobytes())
        if found is None:
            found = known[times.tobytes()] = array("I", map(_zigzag, _second_differences(times)))
        changes += found
    return _planes(changes)


def _second_differences(times: Sequence[int]) -> Iterator[int]:
    before = distance = 0
    for now in times:
        yield now - before - distance
        distance, before = now - before, now


def _zigzag(change: int) -> int:
    # Modulo 2**32, and from -2**31 on; the times themselves fit, so nothing is lost.
    change = ((change + _HALF) & 0xFFFF_FFFF) - _HALF
    return change << 1 if change >= 0 else ~(change << 1)


def _planes(numbers: array[int]) -> bytes:
    if sys.byteorder == "big":
        numbers.byteswap()
    raw, size = numbers.tobytes(), numbers.itemsize
    return b"".join(raw[plane::size] for plane in range(size))
