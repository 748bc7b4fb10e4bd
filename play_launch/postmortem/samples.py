"""What units and the machine used: growth before a failure, busy times, totals.

Samples are kept as they were recorded; of hundreds of thousands, a few are read.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from enum import StrEnum
from struct import Struct as Fixed
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from msgspec import Struct, field

from play_launch.config.node_key import NodeKey
from play_launch.config.text import duration
from play_launch.container.cdr.messages import read_machine
from play_launch.postmortem.mcap_records import LATEST, EqualReader, Taken
from play_launch.supervisor.events import MemoryKind

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from play_launch.postmortem.bag_reader import ChannelInfo, Message
    from play_launch.postmortem.mcap_records import ChannelSequence, EqualMessages

_SECOND: Final = 1_000_000_000
_RECORD: Final = Fixed("<15xQ8x 12x i 12x ddQ B3x II 28x Q")
"""Log time and fields of a ProcessStats, all of which have a fixed place."""
_TIME: Final = Fixed("<15xQ")
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

    name: str
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
MOST_SAMPLES: Final = 4000
"""Of each unit, that are kept: more than an hour at one a second."""
_RECENT: Final = MOST_SAMPLES // 4
"""The latest ones, which are all kept; those before are thinned to as many, evenly in time."""
_TOGETHER: Final = 100_000_000
"""Nanoseconds in which all units are sampled."""
_MOST_SHAPES: Final = 1000
_LITTLE_MEMORY: Final = 0.05
"""Of all memory."""
LITTLE_DISK: Final = 64 * _MB
_BUSY_PRESSURE: Final = 40.0
"""Percent of the time in which something waited for a core."""
_BUSY: Final = 95.0
"""Percent of all cores, where the kernel does not know the former."""
_BUSY_SAMPLES: Final = 3
_MOST_BUSY_TIMES: Final = 1000
"""Of more, the first ones say the same."""
_FIELDS: Final = {
    Quantity.MEMORY: "memory",
    Quantity.THREADS: "threads",
    Quantity.DESCRIPTORS: "descriptors",
}


class Sample(NamedTuple):
    """What a process used."""

    log_time: int
    pid: int
    cpu_percent: float
    cpu_seconds: float
    memory: int
    memory_kind: int
    threads: int
    descriptors: int
    involuntary: int


class _Tick(NamedTuple):
    """Samples of several units at one moment, as they stand in the file."""

    time: int
    records: bytes
    offsets: Mapping[str, int]
    """By the keys of the units."""

    def of(self, key: str) -> Sample:
        return Sample._make(_RECORD.unpack_from(self.records, self.offsets[key]))


class _Shape(NamedTuple):
    """Part of a run that has each unit at most once."""

    begin: int
    end: int
    offsets: dict[str, int]


class Total(Struct):
    """What a unit used in the whole session."""

    begin_ns: int
    latest: Sample
    peak_memory: int
    cpu_seconds: float = 0.0
    """What a process used before its first sample is not of this time."""

    @property
    def mean_cpu(self) -> float | None:
        """The percentage of a core that it used; None where nothing can be said."""
        lasted = self.latest.log_time - self.begin_ns
        return 100 * self.cpu_seconds * _SECOND / lasted if lasted > 0 else None


class Rate(NamedTuple):
    """What a unit used per second."""

    key: str
    cpu: float
    """Percent of one core."""
    preempted: float
    """How often it lost its core to others, although it had work."""


class BusyTime(Struct):
    """A time in which the machine is busy."""

    begin_ns: int = 0
    end_ns: int = 0
    samples: int = 0
    pressure: float = 0.0
    """The highest."""
    rates: list[Rate] = field(default_factory=list)

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


class Samples:
    """Keeps the samples of a recording, and answers questions about them."""

    def __init__(self) -> None:
        self._reader = EqualReader()
        self._ticks: list[_Tick] = []
        self._shapes: dict[ChannelSequence, list[_Shape]] = {}
        self._totals: dict[str, Total] = {}
        self._counted = 0
        """How many of the first ticks are in the totals already."""
        self._machine: list[tuple[int, dict[str, Any]]] = []
        """The first sample of the machine, and the latest."""
        self._busy = BusyTime()
        self._busy_times: list[BusyTime] = []

    def take(self, data: bytes, begin: int, channels: Mapping[int, ChannelInfo]) -> Taken:
        """Take the samples of processes that begin there."""
        found = self._reader.read(data, begin, channels)
        self.add(found)
        return Taken(begin + len(found.records), found.latest)

    def add(self, found: EqualMessages) -> None:
        records, sequence, _ = found
        if sequence.stride < _RECORD.size:
            return
        shapes = self._shapes.get(sequence)
        if shapes is None:
            if len(self._shapes) >= _MOST_SHAPES:
                self._shapes.clear()
            shapes = self._shapes[sequence] = _shapes(sequence)
        for begin, end, offsets in shapes:
            part = records[begin:end]
            (log_time,) = _TIME.unpack_from(part)
            self._ticks.append(_Tick(log_time, part, offsets))
        if len(self._ticks) > MOST_SAMPLES:
            self._thin()

    def take_system(self, message: Message) -> None:
        sample = read_machine(message.data)
        if sample is not None:
            self._machine[1:] = [(message.log_time, sample)]
        if not self._busy.take(message.log_time, sample):
            # Now, as the samples of this time may be thinned later.
            self._end_busy_time()

    def busy_times(self) -> list[BusyTime]:
        """Give the times in which the machine was busy, with what each unit used."""
        self._end_busy_time()
        return self._busy_times

    def before(self, key: str, name: str, pid: int, until_ns: int) -> tuple[Trend, ...]:
        """Give what grew in a process up to a moment, and what the machine ran out of by now."""
        life = self.life(key, until_ns, pid)
        return (
            *(grown(life[0].of(key), life[-1].of(key), name, GROWN) if life else ()),
            *self._shortage(),
        )

    def totals(self) -> dict[str, Total]:
        """Give what each unit used, by its key."""
        totals = self._totals
        for tick in self._ticks[self._counted :]:
            for key in tick.offsets:
                sample = tick.of(key)
                total = totals.get(key)
                if total is None:
                    totals[key] = Total(sample.log_time, sample, sample.memory)
                    continue
                if sample.pid == total.latest.pid:
                    total.cpu_seconds += sample.cpu_seconds - total.latest.cpu_seconds
                total.latest, total.peak_memory = sample, max(total.peak_memory, sample.memory)
        self._counted = len(self._ticks)
        return totals

    def units(self) -> list[str]:
        """Give the keys of all units that have samples."""
        found: dict[str, int] = {}
        for tick in self._ticks:
            found |= tick.offsets
        return list(found)

    def life(self, key: str, until_ns: int = LATEST, pid: int = 0) -> list[_Tick]:
        """Give the samples of one process up to a moment; 0 is the one that lived then."""
        ticks = [tick for tick in self._ticks if key in tick.offsets]
        del ticks[bisect_right(ticks, until_ns, key=_time_of) :]
        while ticks and pid and ticks[-1].of(key).pid != pid:
            if until_ns - ticks.pop().time > 60 * _SECOND:
                return []
        if not ticks:
            return []
        found = ticks[-1].of(key).pid
        # Processes follow one another: those of earlier ones come first.
        return ticks[bisect_left(ticks, True, key=lambda tick: tick.of(key).pid == found) :]

    def disk_free_at_the_end(self) -> Trend | None:
        """Give how the free space on the disk of the recording went; None if not measured."""
        return self._of_machine("disk_free", Quantity.FREE_DISK)

    def _thin(self) -> None:
        self.totals()
        ticks, recent = self._ticks, self._ticks[-_RECENT:]
        gap = (ticks[-1].time - ticks[0].time) // _RECENT
        kept, begun = [], ticks[0].time - gap
        for tick in ticks[:-_RECENT]:
            if tick.time - begun >= gap:
                begun = tick.time
            # The end of a chunk may divide the samples of one moment.
            if tick.time - begun <= min(_TOGETHER, gap // 4):
                kept.append(tick)
        self._ticks = [*kept, *recent]
        self._counted = len(self._ticks)

    def _end_busy_time(self) -> None:
        busy, self._busy = self._busy, BusyTime()
        if busy.samples >= _BUSY_SAMPLES and len(self._busy_times) < _MOST_BUSY_TIMES:
            busy.rates = list(self._rates(busy.begin_ns, busy.end_ns))
            self._busy_times.append(busy)

    def _rates(self, begin_ns: int, end_ns: int) -> Iterator[Rate]:
        begin = bisect_left(self._ticks, begin_ns, key=_time_of)
        ticks = self._ticks[begin : bisect_right(self._ticks, end_ns, key=_time_of)]
        first: dict[str, _Tick] = {}
        last: dict[str, _Tick] = {}
        for tick, earlier in zip(ticks, reversed(ticks), strict=True):
            last.update(dict.fromkeys(tick.offsets, tick))
            first.update(dict.fromkeys(earlier.offsets, earlier))
        for key, tick in last.items():
            old, new = first[key].of(key), tick.of(key)
            seconds = (new.log_time - old.log_time) / _SECOND
            if old.pid == new.pid and seconds > 0:
                cpu = 100 * (new.cpu_seconds - old.cpu_seconds) / seconds
                yield Rate(key, cpu, (new.involuntary - old.involuntary) / seconds)

    def _shortage(self) -> Iterator[Trend]:
        memory = self._of_machine("memory_available", Quantity.FREE_MEMORY)
        total = self._of_machine("memory_total", Quantity.FREE_MEMORY)
        if memory and total and memory.after < total.after * _LITTLE_MEMORY:
            yield memory
        disk = self.disk_free_at_the_end()
        if disk and disk.after < LITTLE_DISK:
            yield disk

    def _of_machine(self, name: str, quantity: Quantity) -> Trend | None:
        if not self._machine:
            return None
        (begin_ns, old), (end_ns, new) = self._machine[0], self._machine[-1]
        return Trend("", quantity, float(old[name]), float(new[name]), begin_ns, end_ns)


def _time_of(tick: _Tick) -> int:
    return tick.time


def _shapes(sequence: ChannelSequence) -> list[_Shape]:
    """Divide a run where a unit occurs again."""
    found, offsets, begin = [], dict[str, int](), 0
    for number, channel in enumerate(sequence.channels):
        key, at = channel.topic.key, number * sequence.stride
        if key in offsets:
            found.append(_Shape(begin, at, offsets))
            offsets, begin = {}, at
        offsets[key] = at - begin
    return [*found, _Shape(begin, sequence.stride * len(sequence.channels), offsets)]


def grown(
    old: Sample, new: Sample, name: str, limits: Mapping[Quantity, Growth]
) -> Iterator[Trend]:
    """Give the quantities that grew beyond their limits."""
    if old.log_time == new.log_time:
        return
    for quantity, growth in limits.items():
        # A container's figure tells nothing about a node.
        if quantity is Quantity.MEMORY and new.memory_kind == MemoryKind.SHARED:
            continue
        before, after = (getattr(each, _FIELDS[quantity]) for each in (old, new))
        if after >= before * growth.factor and after - before >= growth.least:
            yield Trend(name, quantity, before, after, old.log_time, new.log_time)
