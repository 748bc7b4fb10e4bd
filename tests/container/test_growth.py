"""Hundreds of crashes leave nothing behind that is not reported."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import psutil
import pytest
from play_launch_msgs.msg import ComponentEvent, ControlUnload

from tests.support.control_peer import Container, StartContainer
from tests.support.isolated import ALL_MODES, MODES, only_these_remain, start, survives

CYCLES = 240
WARM_UP = 60
"""Cycles after which the container has what it needs."""
SAMPLE_EVERY = 10
WAYS = ("segv", "abrt", "exception")

# A donor or two may wait to be joined at any moment; growth would be hundreds.
MOMENTARY = 3
MEMORY_BOUND = 8 * 1024 * 1024
"""Bytes: a fortieth of what as many heaps of threads would take, many times what is to be seen."""
PER_LEAK = 256 * 1024
"""Bytes that a node which could not be cleaned up after may leave."""


@dataclass(frozen=True)
class Usage:
    descriptors: int
    threads: int
    zombies: int
    segments: int
    memory: int


def anonymous_memory(pid: int) -> int:
    """Bytes that are in memory and belong to no file."""
    found = re.search(
        r"^Anonymous:\s+(\d+) kB", Path(f"/proc/{pid}/smaps_rollup").read_text(), re.MULTILINE
    )
    assert found
    return int(found[1]) * 1024


def segments(pid: int) -> int:
    """Files of /dev/shm that a process has mapped; other tests may have others."""
    maps = Path(f"/proc/{pid}/maps").read_text()
    return len(set(re.findall(r"/dev/shm/.*", maps)))


def usage(container: Container) -> Usage:
    family = psutil.Process(container.process.pid).children(recursive=True)
    return Usage(
        descriptors=container.descriptors(),
        threads=container.threads(),
        zombies=sum(is_zombie(child) for child in family),
        segments=segments(container.process.pid),
        memory=anonymous_memory(container.process.pid),
    )


def is_zombie(process: psutil.Process) -> bool:
    try:
        return bool(process.status() == psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


def growth(samples: Sequence[Usage], field: str) -> float:
    """From the first third to the last."""
    values = [getattr(sample, field) for sample in samples]
    third = len(values) // 3
    return float(median(values[-third:]) - median(values[:third]))


@pytest.mark.parametrize("mode", ALL_MODES)
def test_crashes_reloads_and_unloads_leave_nothing_behind(
    spawn: StartContainer, package: str, mode: str
) -> None:
    container = start(spawn, mode)
    samples: list[Usage] = []
    with survives(container):
        talker = container.loaded("Talker", package=package)
        for cycle in range(CYCLES):
            if mode in MODES:
                dying = {"how": WAYS[cycle % len(WAYS)], "after": 0.0}
                crasher = container.loaded("Crasher", package=package, parameters=dying)
                container.event(ComponentEvent.CRASHED, unique_id=crasher.unique_id)
            if cycle % 4 == 0:
                brief = container.loaded("Talker", package=package, node_name="brief")
                container.send(ControlUnload(unique_id=brief.unique_id))
                container.event(ComponentEvent.UNLOADED, unique_id=brief.unique_id)
            if cycle >= WARM_UP and cycle % SAMPLE_EVERY == 0:
                samples.append(usage(container))
        crashes = CYCLES if mode in MODES else 0
        if crashes:
            assert only_these_remain(container, talker.pid)
        status = container.status_when(
            lambda status: status.undertaken + status.leaked == crashes, "the last cleanup"
        )
        assert status.crashes == crashes
        for field in ("descriptors", "threads", "zombies", "segments"):
            assert growth(samples, field) <= MOMENTARY, samples
        reported = status.leaked + status.unquiesced
        assert growth(samples, "memory") < MEMORY_BOUND + reported * PER_LEAK, (status, samples)
        # What is reported is the exception.
        assert reported < CYCLES / 20, status
