"""CPU time, memory and descriptors of the system's processes, by psutil."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Final, TypeVar

import psutil
from msgspec import Struct
from msgspec.structs import replace

from play_launch.process.identity import NoSuchProcessError, read_stat
from play_launch.supervisor.events import MemoryKind, NodeState, ProcessSample, SubjectKind

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from play_launch.supervisor.view import ContainerView, SystemView

PERIOD: Final = 10.0
"""Seconds for which all but the CPU time holds: psutil takes 0.1 ms for it, and the PSS some ms."""
_HAS_PROCESS: Final = frozenset({NodeState.LOADING, NodeState.LOADED, NodeState.UNLOADING})
_NS: Final = 1_000_000_000
_TICKS: Final = os.sysconf("SC_CLK_TCK")
_Result = TypeVar("_Result")


class Target(Struct, frozen=True):
    """One process to be measured, and the unit that it belongs to."""

    kind: SubjectKind
    key: str
    pid: int
    start_time: int
    """Clock ticks after boot; 0 if unknown."""
    memory_of: int = 0
    """Pid of the container whose memory and descriptors it shares; 0: it has its own."""


def targets(view: SystemView) -> list[Target]:
    """List the processes that should be alive now, containers before their nodes."""
    found = [each for container in view.containers.values() for each in _of_container(container)]
    # Containers may share a process, whose numbers the first of them gets.
    found = list({each.pid: each for each in reversed(found)}.values())[::-1]
    return found + [
        Target(SubjectKind.PROCESS, each.name, each.pid, each.start_time)
        for each in view.processes.values()
        if each.pid
    ]


def _of_container(container: ContainerView) -> list[Target]:
    process = container.process
    if not process.pid:
        return []
    own = Target(SubjectKind.CONTAINER, container.name, process.pid, process.start_time)
    if not container.mechanism:  # its nodes are threads, or it stops
        return [own]
    memory_of = process.pid if container.mechanism == "shared_memory" else 0
    return [own] + [
        Target(SubjectKind.NODE, str(node.key), node.pid, node.start_time, memory_of)
        for node in container.nodes.values()
        if node.state in _HAS_PROCESS and node.pid not in (0, process.pid)
    ]


class _KnownProcess(Struct):
    """State of a process from one sample to the next."""

    process: psutil.Process
    start_time: int
    cpu_ns: int
    at_ns: int
    """Time of `cpu_ns`, on the clock of the boot."""
    sample: ProcessSample | None = None
    due: float = 0.0


class Sampler:
    """Measures processes again and again. It belongs to one thread at a time."""

    def __init__(self) -> None:
        self._known: dict[Target, _KnownProcess] = {}

    def sample(self, targets: Sequence[Target], stamp_ns: int) -> list[ProcessSample]:
        """Measure these processes; exited ones are left out."""
        before, self._known = self._known, {}
        samples: dict[int, ProcessSample] = {}
        for target in targets:
            host = samples.get(target.memory_of)
            if target.memory_of and host is None:
                continue  # exits with its container
            try:
                known = before.get(target) or _first(target)
                samples[target.pid] = _sample(target, known, host, stamp_ns)
            except (NoSuchProcessError, psutil.NoSuchProcess):
                continue
            self._known[target] = known
        return list(samples.values())


def _first(target: Target) -> _KnownProcess:
    process = psutil.Process(target.pid)
    start_time = read_stat(target.pid).start_time
    if target.start_time not in (0, start_time):
        raise NoSuchProcessError(target.pid)
    return _KnownProcess(process, start_time, 0, start_time * _NS // _TICKS)


def _sample(
    target: Target, known: _KnownProcess, host: ProcessSample | None, stamp_ns: int
) -> ProcessSample:
    try:
        cpu_ns = time.clock_gettime_ns(~target.pid << 3 | 2)  # clock_getcpuclockid(3)
    except OSError:
        raise NoSuchProcessError(target.pid) from None
    now, now_ns = time.monotonic(), time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    percent = 100 * (cpu_ns - known.cpu_ns) / max(1, now_ns - known.at_ns)
    known.cpu_ns, known.at_ns = cpu_ns, now_ns
    if known.sample is None or now >= known.due:
        known.sample, known.due = _details(target, known, is_host=host is None), now + PERIOD
    sample = replace(known.sample, stamp_ns=stamp_ns, cpu_percent=percent, cpu_seconds=cpu_ns / _NS)
    if host is None:
        return sample
    return replace(
        sample,
        memory_bytes=host.memory_bytes,
        memory_kind=MemoryKind.SHARED,
        descriptors=host.descriptors,
    )


def _details(target: Target, known: _KnownProcess, *, is_host: bool) -> ProcessSample:
    process = known.process
    memory, kind, descriptors = 0, MemoryKind.RSS, 0
    with process.oneshot():
        storage, switches = _allowed(process.io_counters), process.num_ctx_switches()
        threads = process.num_threads()
    if is_host:
        descriptors = _allowed(process.num_fds) or 0
        if full := _allowed(process.memory_full_info):
            memory, kind = full.pss, MemoryKind.PSS
        else:
            memory = process.memory_info().rss
    return ProcessSample(
        stamp_ns=0,
        kind=target.kind,
        key=target.key,
        pid=target.pid,
        start_time=known.start_time,
        cpu_percent=0.0,
        cpu_seconds=0.0,
        memory_bytes=memory,
        memory_kind=kind,
        threads=threads,
        descriptors=descriptors,
        read_bytes=storage.read_bytes if storage else 0,
        write_bytes=storage.write_bytes if storage else 0,
        voluntary_switches=switches.voluntary,
        involuntary_switches=switches.involuntary,
    )


def _allowed(call: Callable[[], _Result]) -> _Result | None:
    """Return the result, or None for a process of another user."""
    try:
        return call()
    except psutil.AccessDenied:
        return None
