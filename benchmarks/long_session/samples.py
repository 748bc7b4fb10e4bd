"""What the processes of the made-up session and its machine used, once in each period."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator

from benchmarks.long_session.plan import Life, Robot, Timed, stamp
from play_launch.supervisor.events import MemoryKind, ProcessSample, SubjectKind, SystemSample

CORES = 8
TOTAL = 16 << 30
"""Bytes of memory."""
MEGABYTE = 1 << 20
LEAK = 24
"""Bytes per second that a leaking node loses, in units of 64 KiB."""
HOG = (0.5, 0.52)
"""When one node takes the processor from the others, in parts of the session."""
KINDS = {each.name.lower(): each for each in SubjectKind}


def samples(robot: Robot) -> Iterator[Timed]:
    """Give the samples in order: each time those of all that live, then the machine's."""
    source = random.Random(robot.plan.seed + 2)
    steady = {life.key: source.gammavariate(1.5, 3.0) for life in robot.lives}
    size = {life.key: source.gammavariate(2.0, 30.0) * MEGABYTE for life in robot.lives}
    hog = max(steady, key=lambda key: (":" in key, steady[key]))
    begins = sorted(robot.lives, key=lambda life: life.begin, reverse=True)
    living: list[Life] = []
    switches: dict[int, int] = {}
    at = robot.plan.period
    while at < robot.plan.seconds:
        while begins and begins[-1].begin < at:
            living.append(begins.pop())
        living = [life for life in living if life.end > at]
        hungry = HOG[0] < at / robot.plan.seconds < HOG[1]
        used = memory = 0.0
        for number, life in enumerate(living):
            age = at - life.begin
            cpu = max(0.0, source.gauss(steady[life.key], 0.8))
            if age < 3 or source.random() < 0.002:
                cpu = source.uniform(50, 100)
            if hungry:
                cpu = 100.0 if life.key == hog else cpu * 0.4
            bytes_now = size[life.key] * (1 - math.exp(-age / 5)) + 64 * 1024 * (number % 16)
            bytes_now += LEAK * 65536 * age * life.leaks
            used, memory = used + cpu, memory + bytes_now
            switches[life.pid] = switches.get(life.pid, 0) + (40 if hungry else 2)
            yield at, _sample(life, at, cpu, round(bytes_now), switches[life.pid])
        yield at, _system(source, at, used, memory, hungry=hungry)
        at += robot.plan.period


def _sample(life: Life, at: float, cpu: float, memory: int, switches: int) -> ProcessSample:
    age = at - life.begin
    return ProcessSample(
        stamp_ns=stamp(at),
        kind=KINDS[life.kind],
        key=life.key,
        pid=life.pid,
        start_time=round(life.begin * 100),
        cpu_percent=cpu,
        cpu_seconds=age * 0.04,
        memory_bytes=memory,
        memory_kind=MemoryKind.PSS,
        threads=8,
        descriptors=24,
        read_bytes=0,
        write_bytes=round(age * 100),
        voluntary_switches=round(age * 50),
        involuntary_switches=switches,
    )


def _system(
    source: random.Random, at: float, used: float, memory: float, *, hungry: bool
) -> SystemSample:
    busy = min(100.0, used / CORES)
    cores = tuple(min(100.0, max(0.0, source.gauss(busy, 8.0))) for _ in range(CORES))
    return SystemSample(
        stamp_ns=stamp(at),
        cpu_percent=busy,
        core_percent=cores,
        core_mhz=(2400.0,) * CORES,
        memory_total=TOTAL,
        memory_available=max(0, TOTAL - round(memory)),
        swap_used=0,
        shm_used=200 * MEGABYTE,
        shm_total=TOTAL // 2,
        disk_free=80 << 30,
        load_1=used / 100,
        load_5=used / 100,
        load_15=used / 100,
        cpu_some_avg10=min(100.0, busy / 3 + (45.0 if hungry else 0.0)),
        memory_some_avg10=max(0.0, source.gauss(0.2, 0.1)),
        memory_full_avg10=0.0,
        io_some_avg10=max(0.0, source.gauss(0.5, 0.5)),
        io_full_avg10=0.0,
        steal_percent=0.0,
    )
