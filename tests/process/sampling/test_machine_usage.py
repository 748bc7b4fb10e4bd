from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING

import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.process.sampling import machine_usage
from play_launch.process.sampling.machine_usage import CoreTimes, Machine, core_times, pressure_of
from play_launch.process.sampling.process_usage import read_file

if TYPE_CHECKING:
    from pathlib import Path

TICKS = st.integers(0, 2**40)
TIMES = st.builds(CoreTimes, TICKS, TICKS, TICKS)


def test_this_machine(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
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
    assert sample.swap_used == psutil.swap_memory().used
    assert sample.shm_total == psutil.disk_usage("/dev/shm").total
    assert 0 <= sample.shm_used <= sample.shm_total
    assert 0 < sample.disk_free <= psutil.disk_usage(str(tmp_path)).total
    assert min(sample.load_1, sample.load_5, sample.load_15) >= 0


@given(TIMES, TIMES)
def test_shares_are_percentages(before: CoreTimes, now: CoreTimes) -> None:
    busy, stolen = now.shares(before)
    assert 0 <= busy <= 100
    assert 0 <= stolen <= 100
    assert busy + stolen <= 100 + 1e-9


def test_half_of_the_time() -> None:
    assert CoreTimes(150, 1040, 10).shares(CoreTimes(100, 1000, 0)) == (50.0, 10.0)
    assert CoreTimes(1, 2, 3).shares(CoreTimes(1, 2, 3)) == (0.0, 0.0)


def test_cores_are_told_by_number() -> None:
    text = (
        b"cpu  4 1 1 20 5 1 1 3 9 9\ncpu0 2 0 0 10 0 0 0 0\ncpu3 2 1 1 10 5 1 1 3 9 9\nintr 5 cpu"
    )
    assert core_times(text) == {
        -1: CoreTimes(8, 25, 3),
        0: CoreTimes(2, 10, 0),
        3: CoreTimes(6, 15, 3),
    }


def test_a_core_that_is_offline_has_no_percentage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = Machine(tmp_path)
    text = b"cpu  9 0 0 9 0 0 0 0\ncpu0 9 0 0 9 0 0 0 0\ncpu2 9 0 0 9 0 0 0 0\n"
    real = read_file
    monkeypatch.setattr(
        machine_usage, "read_file", lambda path: text if path == "/proc/stat" else real(path)
    )
    machine.sample(1)
    percent = machine.sample(2).core_percent
    assert [math.isnan(one) for one in percent] == [False, True, False]


def test_pressure() -> None:
    text = b"some avg10=1.25 avg60=0.00 avg300=0.00 total=5\nfull avg10=0.50 avg60=9 total=1\n"
    assert pressure_of(text) == {b"some": 1.25, b"full": 0.5}
    assert pressure_of(b"") == {}


def test_a_kernel_without_pressure_and_a_machine_without_shared_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = read_file

    def read(path: str) -> bytes:
        if "pressure" in path:
            raise FileNotFoundError(path)
        return real(path)

    monkeypatch.setattr(machine_usage, "read_file", read)
    monkeypatch.setattr(machine_usage, "_SHARED", os.fspath(tmp_path / "missing"))
    sample = Machine(tmp_path / "gone").sample(1)
    assert math.isnan(sample.cpu_some_avg10)
    assert math.isnan(sample.io_full_avg10)
    assert (sample.shm_total, sample.shm_used, sample.disk_free) == (0, 0, 0)


def test_frequencies_are_in_megahertz(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "0").write_bytes(b"2400000\n")
    monkeypatch.setattr(machine_usage, "_FREQUENCY", f"{tmp_path}/{{}}")
    mhz = Machine(tmp_path).sample(1).core_mhz
    assert mhz[0] == 2400.0
    assert all(math.isnan(one) for one in mhz[1:])
