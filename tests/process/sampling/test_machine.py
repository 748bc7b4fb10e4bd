from __future__ import annotations

import math
import os
from pathlib import Path

import psutil
import pytest

from play_launch.process.sampling.machine import MachineSampler, core_times


def test_this_machine(tmp_path: Path) -> None:
    machine = MachineSampler(tmp_path)
    begin = psutil.cpu_times()
    while psutil.cpu_times() == begin:
        os.sched_yield()
    sample = machine.sample(7)
    assert sample.stamp_ns == 7
    assert 0 <= sample.cpu_percent <= 100
    assert len(sample.core_percent) == psutil.cpu_count()
    assert all(0 <= core <= 100 for core in sample.core_percent)
    assert len(sample.core_mhz) in (0, len(sample.core_percent))
    assert sample.memory_total == psutil.virtual_memory().total
    assert 0 < sample.memory_available < sample.memory_total
    assert sample.shm_total == psutil.disk_usage("/dev/shm").total
    assert 0 <= sample.shm_used <= sample.shm_total
    assert 0 < sample.disk_free <= psutil.disk_usage(str(tmp_path)).total
    assert min(sample.load_1, sample.load_5, sample.load_15) >= 0


def test_a_core_that_is_offline_has_no_percentage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "cpu  {0} 0 0 9 0 0 0 0\ncpu0 {0} 0 0 9 0 0 0 0\ncpu2 {0} 0 0 9 0 0 0 0\nintr 5 cpu"
    real = Path.read_text
    ticks = iter((9, 19))

    def read(path: Path, encoding: str) -> str:
        is_it = str(path) == "/proc/stat"
        return text.format(next(ticks)) if is_it else real(path, encoding)

    monkeypatch.setattr(Path, "read_text", read)
    percent = MachineSampler(tmp_path).sample(2).core_percent
    assert [math.isnan(one) for one in percent] == [False, True, False]
    assert percent[0] == 100


def test_times_of_cores() -> None:
    text = "cpu  4 1 1 20 5 1 1 3 9 9\ncpu3 2 1 1 10 5 1 1 3 9 9\nintr 5 cpu"
    assert core_times(text) == {-1: (8, 25, 3), 3: (6, 15, 3)}
