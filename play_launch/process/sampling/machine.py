"""Load of the machine: cores, memory, file systems, pressure."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import Final

import psutil

from play_launch.supervisor.events import SystemSample

_AVERAGE: Final = re.compile(r"^(some|full) avg10=([0-9.]+)", re.MULTILINE)
_FREQUENCY: Final = "/sys/devices/system/cpu/cpu{}/cpufreq/scaling_cur_freq"
_ALL: Final = -1


class MachineSampler:
    """Measures the machine; percentages are of the time since the last measurement."""

    def __init__(self, folder: Path) -> None:
        """Start measuring; `folder` is that of the recording. Raises OSError."""
        self._folder = folder
        self._before = core_times(Path("/proc/stat").read_text(encoding="ascii"))
        self._has_frequencies = Path(_FREQUENCY.format(0)).exists()

    def sample(self, stamp_ns: int) -> SystemSample:
        """Raise OSError if the kernel's numbers cannot be read."""
        now, before = core_times(Path("/proc/stat").read_text(encoding="ascii")), self._before
        self._before = now
        percent = {core: _shares(now[core], before[core]) for core in now.keys() & before.keys()}
        cores = range(max(now) + 1)
        memory, load = psutil.virtual_memory(), os.getloadavg()
        shared, disk = _space(Path("/dev/shm")), _space(self._folder)  # noqa: S108 - it is measured
        pressure = {name: _pressure(name) for name in ("cpu", "memory", "io")}
        return SystemSample(
            stamp_ns=stamp_ns,
            cpu_percent=percent[_ALL][0],
            core_percent=tuple(percent.get(core, (math.nan,))[0] for core in cores),
            core_mhz=tuple(_mhz(core) for core in cores) if self._has_frequencies else (),
            memory_total=memory.total,
            memory_available=memory.available,
            swap_used=psutil.swap_memory().used,
            shm_used=shared[1],
            shm_total=shared[0],
            disk_free=disk[2],
            load_1=load[0],
            load_5=load[1],
            load_15=load[2],
            cpu_some_avg10=pressure["cpu"].get("some", math.nan),
            memory_some_avg10=pressure["memory"].get("some", math.nan),
            memory_full_avg10=pressure["memory"].get("full", math.nan),
            io_some_avg10=pressure["io"].get("some", math.nan),
            io_full_avg10=pressure["io"].get("full", math.nan),
            steal_percent=percent[_ALL][1],
        )


def core_times(text: str) -> dict[int, tuple[int, int, int]]:
    """Parse ``/proc/stat``: busy, idle and stolen ticks by core, of all cores under -1.

    psutil leaves out cores that are offline, and with them the numbers of those behind.
    """
    times: dict[int, tuple[int, int, int]] = {}
    for line in text.splitlines():
        if not line.startswith("cpu"):
            break
        name, *words = line.split()
        user, nice, system, idle, waiting, interrupts, soft, stolen = map(int, words[:8])
        busy = user + nice + system + interrupts + soft
        times[int(name[3:] or _ALL)] = busy, idle + waiting, stolen
    return times


def _shares(now: tuple[int, int, int], before: tuple[int, int, int]) -> tuple[float, float]:
    """Return the percentages of busy and of stolen time."""
    busy, idle, stolen = (max(0, new - old) for new, old in zip(now, before, strict=True))
    total = (busy + idle + stolen) or 1
    return 100 * busy / total, 100 * stolen / total


def _pressure(name: str) -> dict[str, float]:
    """Return percent of the latest 10 s; empty without pressure stall information."""
    try:
        text = Path("/proc/pressure", name).read_text(encoding="ascii")
    except OSError:
        return {}
    return {kind: float(average) for kind, average in _AVERAGE.findall(text)}


def _space(path: Path) -> tuple[int, int, int]:
    """Return total, used and available bytes; zeros without that file system."""
    try:
        usage = psutil.disk_usage(os.fspath(path))
    except OSError:
        return 0, 0, 0
    return usage.total, usage.used, usage.free


def _mhz(core: int) -> float:
    try:
        return int(Path(_FREQUENCY.format(core)).read_text(encoding="ascii")) / 1000
    except (OSError, ValueError):  # offline
        return math.nan
