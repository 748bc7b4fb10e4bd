"""Measures processes again and again, and makes samples of the differences."""

from __future__ import annotations

import math
import os
import time
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.process.sampling.process_usage import (
    ProcessFiles,
    ProcessUsage,
    process_usage,
    proportional_set_size,
)
from play_launch.supervisor.events import MemoryKind, ProcessSample

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from play_launch.process.sampling.targets import Target

PSS_PERIOD: Final = 10.0
"""Seconds for which a PSS holds: the kernel walks the page tables of the process for it."""
LONGEST_PSS_PERIOD: Final = 60.0
"""The same while the process keeps its RSS, which is known anyway."""
_SAME_SHARE: Final = 0.01
_SAME_BYTES: Final = 1 << 20
"""An RSS counts as kept up to such a share of it, or so many bytes."""
_LEAST_AT_ONCE: Final = 10
"""How many PSS may be taken with one sample; more only where there are more than 100 processes."""
_MOST_KEPT: Final = 128
"""Processes whose files are kept open, two descriptors each; those of further ones are opened and
closed each time."""
_GOLDEN: Final = (math.sqrt(5) - 1) / 2
"""Multiples of it, without their whole parts, are spread evenly, however many there are."""
_TICK_NS: Final = 1_000_000_000 // os.sysconf("SC_CLK_TCK")


class _Known(Struct):
    """What is remembered of a process from one sample to the next."""

    pss: int | None
    """Bytes; None where it cannot be had: another user's process, or an old kernel."""
    pss_at: float
    """When it was taken, on the monotonic clock."""
    rss: int | None = None
    """Bytes, by the first usage that was measured after that."""
    usage: ProcessUsage | None = None
    usage_at: int = 0
    """When it was measured, in nanoseconds of the monotonic clock."""
    files: ProcessFiles | None = None
    """Closed as soon as nobody has them any more."""

    @property
    def pss_period(self) -> float:
        """Seconds for which the PSS holds."""
        if self.usage is None or self.rss is None:
            return PSS_PERIOD
        is_kept = abs(self.usage.rss - self.rss) < max(_SAME_BYTES, _SAME_SHARE * self.rss)
        return LONGEST_PSS_PERIOD if is_kept else PSS_PERIOD


class Sampler:
    """Makes samples of processes. It belongs to one thread at a time."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock`, in seconds, decides when a PSS is due."""
        self._clock = clock
        self._known: dict[Target, _Known] = {}
        self._early = 0.0
        """By how much of its period the second PSS of the next process comes early."""

    def sample(self, targets: Sequence[Target], stamp_ns: int) -> list[ProcessSample]:
        """Measure these processes; one that has ended is left out, and no error.

        A process begins to be sampled with its first PSS. Where there are very many new ones, that
        may be some samples later.
        """
        present = frozenset(targets)
        self._known = {target: known for target, known in self._known.items() if target in present}
        self._take_memory([target for target in targets if not target.memory_of])
        samples: dict[int, ProcessSample] = {}
        for target in targets:
            sample = self._sample(target, samples.get(target.memory_of), stamp_ns)
            if sample is not None:
                samples[target.pid] = sample
        return list(samples.values())

    def _take_memory(self, targets: Sequence[Target]) -> None:
        """Take the PSS of those where it is due, those without one and the oldest first."""
        now = self._clock()

        def taken_at(target: Target) -> float:
            known = self._known.get(target)
            return known.pss_at if known else -math.inf

        def is_due(target: Target) -> bool:
            known = self._known.get(target)
            return known is None or now - known.pss_at >= known.pss_period

        due = sorted(filter(is_due, targets), key=taken_at)
        for target in due[: max(_LEAST_AT_ONCE, math.ceil(len(targets) / PSS_PERIOD))]:
            pss = proportional_set_size(target.pid)
            if known := self._known.get(target):
                known.pss, known.pss_at = (known.pss if pss is None else pss), now
                known.rss = None
            else:
                # Those that were started together are not due together again and again.
                self._known[target] = _Known(pss, now - self._early * PSS_PERIOD)
                self._early = (self._early + _GOLDEN) % 1

    def _sample(
        self, target: Target, host: ProcessSample | None, stamp_ns: int
    ) -> ProcessSample | None:
        if target.memory_of:
            if host is None:
                return None  # it ends with its container, or is sampled when that is
            known = self._known.setdefault(target, _Known(None, 0.0))
        elif target in self._known:
            known = self._known[target]
        else:
            return None
        usage = self._usage(target.pid, known, shares_descriptors=host is not None)
        expected = target.start_time or (known.usage.start_time if known.usage else 0)
        if usage is None or (expected and usage.start_time != expected):
            return None
        before, known.usage = known.usage, usage
        if known.rss is None:
            known.rss = usage.rss
        before_at, known.usage_at = known.usage_at, time.monotonic_ns()
        elapsed = known.usage_at - before_at if before else _age(usage.start_time)
        used = usage.cpu_ns - before.cpu_ns if before else usage.cpu_ns
        if host is not None:
            memory, kind = host.memory_bytes, MemoryKind.SHARED
        elif known.pss is None:
            memory, kind = usage.rss, MemoryKind.RSS
        else:
            memory, kind = known.pss, MemoryKind.PSS
        return ProcessSample(
            stamp_ns=stamp_ns,
            kind=target.kind,
            key=target.key,
            pid=target.pid,
            start_time=usage.start_time,
            cpu_percent=100 * used / elapsed if elapsed > 0 else 0.0,
            cpu_seconds=usage.cpu_ns / 1e9,
            memory_bytes=memory,
            memory_kind=kind,
            threads=usage.threads,
            descriptors=host.descriptors if host is not None else usage.descriptors,
            read_bytes=usage.read_bytes,
            write_bytes=usage.write_bytes,
            voluntary_switches=usage.voluntary_switches,
            involuntary_switches=usage.involuntary_switches,
        )

    def _usage(self, pid: int, known: _Known, *, shares_descriptors: bool) -> ProcessUsage | None:
        if known.files is None:
            if len(self._known) > _MOST_KEPT:
                return process_usage(pid, shares_descriptors=shares_descriptors)
            try:
                known.files = ProcessFiles(pid)
            except OSError:  # it has ended
                return None
        return known.files.usage(shares_descriptors=shares_descriptors)


def _age(start_time: int) -> int:
    """Nanoseconds since a process was started."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) - start_time * _TICK_NS
