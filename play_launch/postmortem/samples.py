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
from play_launch.container.cdr.messages import read_machine
from play_launch.postmortem.records import LATEST, Runs
from play_launch.supervisor.events import MemoryKind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from play_launch.postmortem.bag_reader import Message, RecordedTopic

_SECOND: Final = 1_000_000_000
_FIXED: Final = Fixed("<4xiIi4xQddQB3xII4xQQQQ")
"""A ProcessStats: all of its fields have a fixed place."""
_RECORD: Final = Fixed(f"<15xQ8x{_FIXED.size}s")
"""The record of one: log time and fields."""
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
MOST_SAMPLES: Final = 4000
"""Of one thing, that are kept: more than an hour at one a second."""
_RECENT: Final = MOST_SAMPLES // 4
"""The latest ones, which are all kept; those before are thinned to as many, evenly in time."""
_LEAK_SAMPLES: Final = 30
_LITTLE_MEMORY: Final = 0.05
"""Of all memory."""
LITTLE_DISK: Final = 64 * _MB
_BUSY_PRESSURE: Final = 40.0
"""Percent of the time in which something waited for a core."""
_BUSY: Final = 95.0
"""Percent of all cores, where the kernel does not know the former."""
_BUSY_SAMPLES: Final = 3
_MOST_STARVATIONS: Final = 1000
"""Of more, the first ones say the same."""
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

    __slots__ = ("_counted", "_latest", "_peak", "_used", "data", "times")

    def __init__(self) -> None:
        self.times = array("q")
        self.data = bytearray()
        self._counted = 0
        """How many of the first samples are in the peak and the CPU time already."""
        self._peak = self._used = 0.0
        self._latest = (0, 0.0)
        """Process and CPU time of the latest one that is counted."""

    def __len__(self) -> int:
        return len(self.times)

    def take(self, message: Message) -> None:
        """Keep a sample; of a long session, fewer of each hour."""
        if len(message.data) < _FIXED.size:
            return
        self.times.append(message.log_time)
        self.data += message.data[: _FIXED.size]
        self.thin()

    def at(self, index: int) -> _Sample:
        _, _, pid, _, percent, seconds, memory, kind, threads, descriptors, _, _, _, lost = (
            _FIXED.unpack_from(self.data, index * _FIXED.size)
        )
        return _Sample(pid, percent, seconds, memory, kind, threads, descriptors, lost)

    def peak_memory(self) -> float:
        """Give the most bytes that it had."""
        self._count()
        return self._peak

    def mean_cpu(self) -> float:
        """Give the percentage of a core that it used; negative where nothing can be said."""
        self._count()
        seconds = (self.times[-1] - self.times[0]) / _SECOND
        return 100 * self._used / seconds if seconds > 0 else -1.0

    def _count(self) -> None:
        for index in range(self._counted, len(self)):
            sample, (pid, before) = self.at(index), self._latest
            # What a process used before its first sample is not of this time.
            self._used += sample.cpu_seconds - before if sample.pid == pid else 0.0
            self._latest = sample.pid, sample.cpu_seconds
            self._peak = max(self._peak, sample.memory)
        self._counted = len(self)

    def thin(self) -> None:
        """Keep fewer samples, if there are too many."""
        if len(self.times) <= MOST_SAMPLES:
            return
        self._count()
        recent, gap = len(self) - _RECENT, (self.times[-1] - self.times[0]) // _RECENT
        kept, next_at = [], self.times[0]
        for index in range(recent):
            if self.times[index] >= next_at:
                kept.append(index)
                next_at = self.times[index] + gap
        kept += range(recent, len(self))
        size = _FIXED.size
        self.times = array("q", [self.times[index] for index in kept])
        self.data = bytearray().join(self.data[index * size : (index + 1) * size] for index in kept)
        self._counted = len(self)

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


class Samples(Runs):
    """Takes the samples of a recording, and answers questions about them at its end."""

    def __init__(self) -> None:
        """Begin without samples."""
        self._series: dict[str, _Series] = {}
        self._system: list[tuple[int, bytes]] = []
        """The first sample of the machine, and the latest."""
        self._busy = _BusyTime()
        self._starvations: list[Starvation] = []

    def of(self, key: str) -> Callable[[Message], None]:
        """Give what keeps the samples of a process."""
        return self._series.setdefault(key, _Series()).take

    def take_run(self, records: bytes, stride: int, topics: list[RecordedTopic]) -> None:
        """Take samples of processes as they stand in the file."""
        if stride < _RECORD.size:
            return
        each = Fixed(f"{_RECORD.format}{stride - _RECORD.size}x").iter_unpack(records)
        for topic, (log_time, data) in zip(topics, each, strict=True):
            one = self._series[topic.key]
            try:
                one.times.append(log_time)
            except OverflowError:
                one.times.append(LATEST)
            one.data += data
        for topic in topics:
            self._series[topic.key].thin()

    def take_system(self, message: Message) -> None:
        """Take one of the machine."""
        if not self._busy.take(message.log_time, read_machine(message.data)):
            # Now, as the samples of this time may be thinned later.
            self._starvations += self._starvation()
            self._busy = _BusyTime()
        self._system[1:] = [(message.log_time, message.data)]

    def before(self, key: str, who: str, pid: int, until_ns: int) -> tuple[Trend, ...]:
        """Give what grew in a process up to a moment, and what the machine ran out of by now."""
        series = self._series.get(key)
        life = series.life(pid, until_ns) if series else None
        grown = tuple(_grown(series, *life, who, GROWN)) if series and life else ()
        return (*grown, *self._shortage())

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
            key: mean for key, series in self._with_samples() if (mean := series.mean_cpu()) >= 0
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
            first, lasted = series.times[begin], series.times[last] - series.times[begin]
            # What a node takes while it starts is no leak.
            begin = bisect_left(series.times, first + lasted // 10)
            middle = bisect_left(series.times, first + lasted * 11 // 20)
            rising = {each.quantity for each in _grown(series, middle, last, "", _RISE)}
            for trend in _grown(series, begin, last, name_of(key), LEAKS):
                if trend.quantity in rising:
                    yield key, trend

    def starvations(self) -> list[Starvation]:
        """Give the units that used a core while others waited, for each busy time."""
        return [*self._starvations, *self._starvation()][:_MOST_STARVATIONS]

    def _starvation(self) -> Iterator[Starvation]:
        """Judge the busy time that is over."""
        begin_ns, end_ns = self._busy.begin_ns, self._busy.end_ns
        if self._busy.samples < _BUSY_SAMPLES or len(self._starvations) >= _MOST_STARVATIONS:
            return
        rates = sorted(self._rates(begin_ns, end_ns), key=lambda rate: -rate.cpu)
        if not rates or rates[0].cpu < _HOG:
            return
        hog, others = rates[0], rates[1:]
        hit = [one for one in others if one.lost >= _PREEMPTED]
        hit = sorted(hit, key=lambda one: -one.lost)[:_MOST_HIT]
        if hit:
            trends = [
                Trend(name_of(key), quantity, 0.0, value, begin_ns, end_ns)
                for key, quantity, value in (
                    (hog.key, Quantity.PROCESSOR, hog.cpu),
                    *((one.key, Quantity.WAITING, one.lost) for one in hit),
                    ("", Quantity.PRESSURE, self._busy.pressure),
                )
            ]
            yield Starvation(
                hog.key, tuple(name_of(one.key) for one in hit), tuple(trends), begin_ns
            )

    def disk_free_at_the_end(self) -> Trend | None:
        """Give how the free space on the disk of the recording went; None if not measured."""
        return self._of_machine("disk_free", Quantity.FREE_DISK)

    def _shortage(self) -> Iterator[Trend]:
        memory = self._of_machine("memory_available", Quantity.FREE_MEMORY)
        total = self._of_machine("memory_total", Quantity.FREE_MEMORY)
        if memory and total and memory.after < total.after * _LITTLE_MEMORY:
            yield memory
        disk = self.disk_free_at_the_end()
        if disk and disk.after < LITTLE_DISK:
            yield disk

    def _of_machine(self, field: str, quantity: Quantity) -> Trend | None:
        samples = [read_machine(data) for _, data in self._system]
        if not samples or samples[0] is None or samples[-1] is None:
            return None
        before, after = float(samples[0][field]), float(samples[-1][field])
        return Trend("", quantity, before, after, self._system[0][0], self._system[-1][0])

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


class _BusyTime(Struct):
    """A time in which the machine is busy."""

    begin_ns: int = 0
    end_ns: int = 0
    samples: int = 0
    pressure: float = 0.0
    """The highest."""

    def take(self, log_time: int, sample: dict[str, Any] | None) -> bool:
        """Take a sample of the machine; return whether it belongs to this time."""
        if sample is None or not _is_busy(sample["cpu_some_avg10"], sample["cpu_percent"]):
            return False
        self.begin_ns, self.end_ns = self.begin_ns or log_time, log_time
        self.samples += 1
        if not math.isnan(sample["cpu_some_avg10"]):
            self.pressure = max(self.pressure, sample["cpu_some_avg10"])
        return True


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


def _value(sample: _Sample, quantity: Quantity) -> float:
    match quantity:
        case Quantity.MEMORY:
            return sample.memory
        case Quantity.THREADS:
            return sample.threads
        case _:
            return sample.descriptors
