"""What units and the machine used: growth before a failure, leaks, starvation.

Samples are kept as they were recorded; of hundreds of thousands, a few are read.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_left, bisect_right
from enum import StrEnum
from struct import Struct as Fixed
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from msgspec import Struct

from play_launch.config.durations import duration
from play_launch.config.node_key import NodeKey
from play_launch.container.cdr.layout import CdrError
from play_launch.container.cdr.messages import SYSTEM_STATS
from play_launch.supervisor.events import MemoryKind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from play_launch.postmortem.bag_reader import Message

_SECOND: Final = 1_000_000_000
_FIXED: Final = Fixed("<4xiIi4xQddQB3xII4xQQQQ")
"""A ProcessStats: all of its fields have a fixed place."""
_MB: Final = 1_000_000


class Quantity(StrEnum):
    """What can grow; its unit."""

    MEMORY = "memory_bytes"
    THREADS = "threads"
    DESCRIPTORS = "descriptors"
    PROCESSOR = "cpu_percent"
    """Of one core."""
    WAITING = "involuntary_switches_per_s"
    """How often per second it lost its core to others, although it had work."""
    FREE_MEMORY = "memory_available_bytes"
    FREE_DISK = "disk_free_bytes"
    PRESSURE = "cpu_some_avg10"
    """Percent of the time in which something waited for a core."""


class Trend(Struct, frozen=True):
    """How a number went; times are nanoseconds since the epoch."""

    who: str
    """Name of the node, container or process; empty for the machine."""
    quantity: Quantity
    before: float
    after: float
    begin_ns: int
    end_ns: int

    def __str__(self) -> str:
        """``memory 120.0 MB -> 2.10 GB in 40 min 0 s``."""
        name = _NUMBERS.get(self.quantity, self.quantity.value)
        before, after = (_number(value, self.quantity) for value in (self.before, self.after))
        return f"{name} {before} -> {after} in {duration(self.end_ns - self.begin_ns)}"


_NUMBERS: Final = {
    Quantity.MEMORY: "memory",
    Quantity.THREADS: "threads",
    Quantity.DESCRIPTORS: "open files",
    Quantity.FREE_MEMORY: "free memory of the machine",
    Quantity.FREE_DISK: "free space on the disk of the recording",
}
_BYTES: Final = frozenset({Quantity.MEMORY, Quantity.FREE_MEMORY, Quantity.FREE_DISK})


def _number(value: float, quantity: Quantity) -> str:
    if quantity not in _BYTES:
        return f"{value:.0f}"
    return f"{value / 1e9:.2f} GB" if value >= 1e9 else f"{value / 1e6:.1f} MB"


def name_of(key: str) -> str:
    """Give the name in a key: ``/talker`` of ``/box:/talker``."""
    return NodeKey.parsed(key).name if ":/" in key else key


class Growth(NamedTuple):
    """From when on a number counts as grown: times as much, and so much more."""

    factor: float
    least: float


GROWN: Final = {
    Quantity.MEMORY: Growth(1.5, 32 * _MB),
    Quantity.THREADS: Growth(2.0, 20),
    Quantity.DESCRIPTORS: Growth(2.0, 50),
}
"""Before a failure."""
LEAKS: Final = {
    Quantity.MEMORY: Growth(2.0, 128 * _MB),
    Quantity.THREADS: Growth(4.0, 100),
    Quantity.DESCRIPTORS: Growth(4.0, 200),
}
"""Without one."""
MOST_SAMPLES: Final = 8000
"""Of one thing, that are kept: more than two hours at one a second."""
_LEAK_SAMPLES: Final = 30
_LITTLE_MEMORY: Final = 0.05
"""Of all memory."""
LITTLE_DISK: Final = 64 * _MB
_BUSY_PRESSURE: Final = 40.0
"""Percent of the time in which something waited for a core."""
_BUSY: Final = 95.0
"""Percent of all cores, where the kernel does not know the former."""
_BUSY_SAMPLES: Final = 3
_MOST_BUSY: Final = 1000
"""Times; of more, the first ones say the same."""
_HOG: Final = 40.0
"""Percent of one core: two that want the same one get half of it each."""
_PREEMPTED: Final = 10.0
"""Involuntary context switches per second of a starved unit, at least."""
_MOST_HIT: Final = 3


class Starvation(NamedTuple):
    """A time in which a unit used a core that others waited for."""

    key: str
    hit: tuple[str, ...]
    """Names."""
    trends: tuple[Trend, ...]
    begin_ns: int


class _Sample(NamedTuple):
    pid: int
    cpu_percent: float
    cpu_seconds: float
    memory: int
    memory_kind: int
    threads: int
    descriptors: int
    involuntary: int


class _Series:
    """The samples of one thing, in the order of time."""

    __slots__ = ("_data", "peak", "times")

    def __init__(self) -> None:
        self.times = array("q")
        self._data = bytearray()
        self.peak = 0.0
        """Bytes of memory, of those that are not here any more."""

    def __len__(self) -> int:
        return len(self.times)

    def take(self, message: Message) -> None:
        """Keep a sample; of a session of days, fewer of each hour."""
        if len(message.data) < _FIXED.size:
            return
        self.times.append(message.log_time)
        self._data += message.data[: _FIXED.size]
        if len(self) > MOST_SAMPLES:
            self.peak = self.peak_memory()
            kept = [*range(0, len(self) - 1, 2), len(self) - 1]
            self.times = array("q", [self.times[index] for index in kept])
            size = _FIXED.size
            self._data = bytearray(b"").join(
                self._data[index * size : (index + 1) * size] for index in kept
            )

    def at(self, index: int) -> _Sample:
        _, _, pid, _, percent, seconds, memory, kind, threads, descriptors, _, _, _, lost = (
            _FIXED.unpack_from(self._data, index * _FIXED.size)
        )
        return _Sample(pid, percent, seconds, memory, kind, threads, descriptors, lost)

    def peak_memory(self) -> float:
        """Give the most bytes that it had."""
        return max(self.peak, *(self.at(index).memory for index in range(len(self))))

    def life(self, pid: int, until_ns: int) -> tuple[int, int] | None:
        """Give the first and the last index of a process up to a moment."""
        last = bisect_right(self.times, until_ns) - 1
        while last >= 0 and pid and self.at(last).pid != pid:
            last -= 1
            if until_ns - self.times[max(last, 0)] > 60 * _SECOND:
                return None
        if last < 0:
            return None
        begin, end, found = 0, last, self.at(last)
        # Processes follow one another: those of earlier ones come first.
        while begin < end:
            middle = (begin + end) // 2
            if self.at(middle).pid == found.pid:
                end = middle
            else:
                begin = middle + 1
        return begin, last


class Samples:
    """Takes the samples of a recording, and answers questions about them at its end."""

    def __init__(self) -> None:
        """Begin without samples."""
        self._series: dict[str, _Series] = {}
        self._names: dict[str, str] = {}
        self._system: list[tuple[int, bytes]] = []
        self._busy = _Busy()

    def of(self, key: str) -> Callable[[Message], None]:
        """Give what keeps the samples of a process."""
        return self._series.setdefault(key, _Series()).take

    def take_system(self, message: Message) -> None:
        """Keep one of the machine; of a session of days, fewer of each hour."""
        self._busy.take(message.log_time, _system(message.data))
        self._system.append((message.log_time, message.data))
        if len(self._system) > MOST_SAMPLES:
            del self._system[1:-1:2]

    def before(self, key: str, who: str, pid: int, until_ns: int) -> tuple[Trend, ...]:
        """Give what grew in a process up to a moment, and what the machine ran out of."""
        series = self._series.get(key)
        life = series.life(pid, until_ns) if series else None
        grown = tuple(_grown(series, *life, who, GROWN)) if series and life else ()
        return (*grown, *self._shortage(until_ns))

    def peak_memory(self) -> dict[str, float]:
        """Give the most bytes that each had, by key; without nodes that share their container's."""
        return {
            key: series.peak_memory()
            for key, series in self._with_samples()
            if series.at(len(series) - 1).memory_kind != MemoryKind.SHARED
        }

    def used(self) -> dict[str, _Sample]:
        """Give the latest sample of each, by key."""
        return {key: series.at(len(series) - 1) for key, series in self._with_samples()}

    def mean_cpu(self) -> dict[str, float]:
        """Give the percentage of a core that each used, by key: CPU time by time."""
        return {
            key: mean for key, series in self._with_samples() if (mean := _mean_cpu(series)) >= 0
        }

    def _with_samples(self) -> Iterator[tuple[str, _Series]]:
        return ((key, series) for key, series in self._series.items() if len(series))

    def leaks(self) -> Iterator[tuple[str, Trend]]:
        """Give what grew in those that live at the end, with their keys."""
        for key, series in self._with_samples():
            life = series.life(0, series.times[-1])
            if life is None or life[1] - life[0] < _LEAK_SAMPLES:
                continue
            begin, last = life
            # What a node takes while it starts is no leak.
            begin += (last - begin) // 10
            middle = (begin + last) // 2
            rising = {each.quantity for each in _grown(series, middle, last, "", _RISE)}
            for trend in _grown(series, begin, last, name_of(key), LEAKS):
                if trend.quantity in rising:
                    yield key, trend

    def starvations(self) -> Iterator[Starvation]:
        """Give the units that used a core while others waited, for each busy time."""
        for begin_ns, end_ns, pressure in self._busy.times():
            rates = sorted(self._rates(begin_ns, end_ns), key=lambda rate: -rate.cpu)
            if not rates or rates[0].cpu < _HOG:
                continue
            hog, others = rates[0], rates[1:]
            hit = [one for one in others if one.lost >= _PREEMPTED]
            hit = sorted(hit, key=lambda one: -one.lost)[:_MOST_HIT]
            if hit:
                trends = [
                    Trend(name_of(hog.key), Quantity.PROCESSOR, 0.0, hog.cpu, begin_ns, end_ns)
                ]
                trends += [
                    Trend(name_of(one.key), Quantity.WAITING, 0.0, one.lost, begin_ns, end_ns)
                    for one in hit
                ]
                trends.append(Trend("", Quantity.PRESSURE, 0.0, pressure, begin_ns, end_ns))
                names = tuple(name_of(one.key) for one in hit)
                yield Starvation(hog.key, names, tuple(trends), begin_ns)

    def disk_free_at_the_end(self) -> Trend | None:
        """Give how the free space on the disk of the recording went; None if not measured."""
        ends = [_system(data) for _, data in (self._system[:1] + self._system[-1:])]
        if not ends or ends[0] is None or ends[-1] is None:
            return None
        before, after = float(ends[0]["disk_free"]), float(ends[-1]["disk_free"])
        return Trend("", Quantity.FREE_DISK, before, after, self._system[0][0], self._system[-1][0])

    def _shortage(self, until_ns: int) -> Iterator[Trend]:
        last = bisect_right(self._system, until_ns, key=lambda one: one[0]) - 1
        now = _system(self._system[last][1]) if last >= 0 else None
        first = _system(self._system[0][1]) if last >= 0 else None
        if not now or not first:
            return
        times = (self._system[0][0], self._system[last][0])
        if now["memory_available"] < now["memory_total"] * _LITTLE_MEMORY:
            values = float(first["memory_available"]), float(now["memory_available"])
            yield Trend("", Quantity.FREE_MEMORY, *values, *times)
        if now["disk_free"] < LITTLE_DISK:
            values = float(first["disk_free"]), float(now["disk_free"])
            yield Trend("", Quantity.FREE_DISK, *values, *times)

    def _rates(self, begin_ns: int, end_ns: int) -> Iterator[_Rate]:
        for key, series in self._series.items():
            first = bisect_left(series.times, begin_ns)
            last = bisect_right(series.times, end_ns) - 1
            if last <= first:
                continue
            old, new = series.at(first), series.at(last)
            seconds = (series.times[last] - series.times[first]) / _SECOND
            if old.pid != new.pid or seconds <= 0:
                continue
            cpu = 100 * (new.cpu_seconds - old.cpu_seconds) / seconds
            yield _Rate(key, cpu, (new.involuntary - old.involuntary) / seconds)


class _Busy:
    """The times in which the machine was busy, and the highest pressure in each."""

    def __init__(self) -> None:
        self._times: list[tuple[int, int, float]] = []
        self._begin = self._end = self._count = 0
        self._most = 0.0

    def take(self, log_time: int, sample: dict[str, Any] | None) -> None:
        pressure = sample["cpu_some_avg10"] if sample else 0.0
        if sample and _is_busy(pressure, sample["cpu_percent"]):
            self._begin = self._begin or log_time
            self._end, self._count = log_time, self._count + 1
            self._most = max(self._most, 0.0 if math.isnan(pressure) else pressure)
            return
        self._times = self.times()
        self._begin = self._end = self._count = 0
        self._most = 0.0

    def times(self) -> list[tuple[int, int, float]]:
        if self._count >= _BUSY_SAMPLES and len(self._times) < _MOST_BUSY:
            return [*self._times, (self._begin, self._end, self._most)]
        return self._times


def _is_busy(pressure: float, percent: float) -> bool:
    return percent >= _BUSY if math.isnan(pressure) else pressure >= _BUSY_PRESSURE


class _Rate(NamedTuple):
    key: str
    cpu: float
    """Percent of one core."""
    lost: float
    """Times per second."""


_RISE: Final = dict.fromkeys(LEAKS, Growth(1.1, 1))


def _grown(
    series: _Series, begin: int, last: int, who: str, limits: dict[Quantity, Growth]
) -> Iterator[Trend]:
    old, new = series.at(begin), series.at(last)
    if begin == last:
        return
    times = (series.times[begin], series.times[last])
    for quantity, growth in limits.items():
        # A container's figure tells nothing about a node.
        if quantity is Quantity.MEMORY and new.memory_kind == MemoryKind.SHARED:
            continue
        before, after = _value(old, quantity), _value(new, quantity)
        if after >= before * growth.factor and after - before >= growth.least:
            yield Trend(who, quantity, before, after, *times)


def _mean_cpu(series: _Series) -> float:
    """Percent of a core; negative where nothing can be said."""
    seconds = (series.times[-1] - series.times[0]) / _SECOND
    if seconds <= 0:
        return -1.0
    used = before = 0.0
    pid = 0
    for index in range(len(series)):
        sample = series.at(index)
        # What it used before the first sample of all is not of this time.
        used += sample.cpu_seconds - before if sample.pid == pid else 0.0
        pid, before = sample.pid, sample.cpu_seconds
    return 100 * used / seconds


def _value(sample: _Sample, quantity: Quantity) -> float:
    match quantity:
        case Quantity.MEMORY:
            return sample.memory
        case Quantity.THREADS:
            return sample.threads
        case _:
            return sample.descriptors


def _system(data: bytes) -> dict[str, Any] | None:
    try:
        return SYSTEM_STATS.read(data)
    except CdrError:
        return None
