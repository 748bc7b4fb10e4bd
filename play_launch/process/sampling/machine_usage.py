"""What the machine does, from ``/proc``, ``/sys`` and its file systems."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.process.sampling.process_usage import field, read_file
from play_launch.supervisor.events import SystemSample

if TYPE_CHECKING:
    from collections.abc import Mapping

_KIB: Final = 1024
_SHARED: Final = "/dev/shm"  # noqa: S108 - it is what is looked at
_FREQUENCY: Final = "/sys/devices/system/cpu/cpu{}/cpufreq/scaling_cur_freq"
_AVERAGE: Final = re.compile(rb"^(some|full) avg10=([0-9.]+)", re.MULTILINE)
_ALL: Final = -1


class CoreTimes(NamedTuple):
    """Clock ticks of one core since boot."""

    busy: int
    idle: int
    stolen: int

    def shares(self, before: CoreTimes) -> tuple[float, float]:
        """Percent of the time since `before` that it was busy, and that others had of it."""
        busy, idle, stolen = (max(0, now - then) for now, then in zip(self, before, strict=True))
        total = busy + idle + stolen
        return (100 * busy / total, 100 * stolen / total) if total else (0.0, 0.0)


class Machine:
    """Measures the machine; percentages are of the time since it was measured before."""

    def __init__(self, folder: Path) -> None:
        """Measure the beginning; `folder` is where the recording is written.

        Raises:
            OSError: When the kernel's numbers cannot be read.
        """
        self._folder = folder
        self._before = core_times(read_file("/proc/stat"))
        self._shows_frequency = Path(_FREQUENCY.format(0)).exists()

    def sample(self, stamp_ns: int) -> SystemSample:
        """Measure it.

        Raises:
            OSError: As above.
        """
        now, before = core_times(read_file("/proc/stat")), self._before
        self._before = now
        memory = b"\n" + read_file("/proc/meminfo")
        load = read_file("/proc/loadavg").split()
        cpu, steal = now[_ALL].shares(before[_ALL])
        cores = range(max(now) + 1)
        shm_total, shm_free = _space(_SHARED, free_for_all=False)
        pressure = {name: _pressure(name) for name in ("cpu", "memory", "io")}
        return SystemSample(
            stamp_ns=stamp_ns,
            cpu_percent=cpu,
            core_percent=tuple(
                now[core].shares(before[core])[0] if core in now and core in before else math.nan
                for core in cores
            ),
            core_mhz=tuple(_mhz(core) for core in cores) if self._shows_frequency else (),
            memory_total=_bytes(memory, b"MemTotal:"),
            memory_available=_bytes(memory, b"MemAvailable:"),
            swap_used=_bytes(memory, b"SwapTotal:") - _bytes(memory, b"SwapFree:"),
            shm_used=shm_total - shm_free,
            shm_total=shm_total,
            disk_free=_space(str(self._folder), free_for_all=True)[1],
            load_1=float(load[0]),
            load_5=float(load[1]),
            load_15=float(load[2]),
            cpu_some_avg10=pressure["cpu"].get(b"some", math.nan),
            memory_some_avg10=pressure["memory"].get(b"some", math.nan),
            memory_full_avg10=pressure["memory"].get(b"full", math.nan),
            io_some_avg10=pressure["io"].get(b"some", math.nan),
            io_full_avg10=pressure["io"].get(b"full", math.nan),
            steal_percent=steal,
        )


def core_times(text: bytes) -> dict[int, CoreTimes]:
    """Read ``/proc/stat``: the times of each core by its number, and those of all by -1."""
    times: dict[int, CoreTimes] = {}
    for line in text.split(b"\n"):
        if not line.startswith(b"cpu"):
            break  # those of the cores are the first
        name, *words = line.split()
        user, nice, system, idle, waiting, interrupts, soft, stolen = map(int, words[:8])
        times[int(name[3:] or _ALL)] = CoreTimes(
            user + nice + system + interrupts + soft, idle + waiting, stolen
        )
    return times


def pressure_of(text: bytes) -> Mapping[bytes, float]:
    """Read a file of ``/proc/pressure``: ``some`` and ``full``, in percent of the latest 10 s."""
    return {kind: float(average) for kind, average in _AVERAGE.findall(text)}


def _pressure(name: str) -> Mapping[bytes, float]:
    try:
        return pressure_of(read_file(f"/proc/pressure/{name}"))
    except OSError:  # the kernel has none, or was started without
        return {}


def _bytes(text: bytes, name: bytes) -> int:
    return (field(text, name) or 0) * _KIB


def _space(path: str, *, free_for_all: bool) -> tuple[int, int]:
    """Size and free bytes of a file system; `free_for_all`: without what is kept for root."""
    try:
        found = os.statvfs(path)
    except OSError:
        return 0, 0
    free = found.f_bavail if free_for_all else found.f_bfree
    return found.f_blocks * found.f_frsize, free * found.f_frsize


def _mhz(core: int) -> float:
    try:
        return int(read_file(_FREQUENCY.format(core))) / 1000
    except (OSError, ValueError):  # it is offline
        return math.nan
