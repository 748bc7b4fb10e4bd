"""Containers in each of the four modes, and what remains of them."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import psutil

from play_launch.container.environment import find_allocator, for_isolation
from tests.support.control_peer import PAUSE, TIMEOUT, Container, StartContainer

MODES = {
    "isolated": ("--isolated",),
    "isolated_mt": ("--isolated", "--use_multi_threaded_executor"),
}
ALL_MODES = {"standard": (), "mt": ("--use_multi_threaded_executor",), **MODES}


def allocator_environment() -> dict[str, str]:
    """What the supervisor gives an isolated container: an allocator, or the best without one."""
    return for_isolation({}, find_allocator().library)


def start(
    spawn: StartContainer,
    mode: str = "isolated",
    *arguments: str,
    failpoints: str = "",
    environment: Mapping[str, str] | None = None,
) -> Container:
    """A container in that mode, with the allocator that isolated modes should have."""
    allocator = allocator_environment() if mode in MODES else {}
    return spawn(
        *ALL_MODES[mode],
        *arguments,
        failpoints=failpoints,
        environment={**allocator, **(environment or {})},
    )


def children(container: Container) -> set[int]:
    """Process ids of all processes below the container."""
    return {child.pid for child in psutil.Process(container.process.pid).children(recursive=True)}


def only_these_remain(container: Container, *pids: int) -> bool:
    """Wait until the container has no other processes; what cleans up may take a moment."""
    deadline = time.monotonic() + TIMEOUT
    while (found := children(container)) != set(pids):
        if time.monotonic() > deadline:
            others = [_described(pid) for pid in sorted(found - set(pids))]
            threads = [_described(pid) for pid in _threads(container.process.pid)]
            raise AssertionError(
                f"there are also {others}, and {set(pids) - found} are missing; threads of the "
                f"container: {threads}; log:\n{container.log.read_text()}"
            )
        time.sleep(PAUSE)
    return True


def _threads(pid: int) -> list[int]:
    return [int(task.name) for task in Path(f"/proc/{pid}/task").iterdir()]


def _described(pid: int) -> str:
    """Name, state, and what it waits for."""
    try:
        name, _, rest = Path(f"/proc/{pid}/stat").read_text().rpartition(")")
        wait = Path(f"/proc/{pid}/wchan").read_text()
        call = Path(f"/proc/{pid}/syscall").read_text().split(" ", 2)[:2]
    except OSError as error:
        return f"{pid} ({error.strerror})"
    return f"{name}) {rest.split()[0]} {wait} {' '.join(call)}"


def start_time(pid: int) -> int:
    """In clock ticks after boot."""
    return int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[19])


def is_gone(pid: int) -> bool:
    """Whether there is no such process, not even a zombie."""
    return not Path(f"/proc/{pid}").exists()


@contextmanager
def survives(container: Container) -> Iterator[None]:
    """The container is the same process afterwards, and ends in order when it is told to."""
    before = start_time(container.process.pid)
    yield
    assert container.process.poll() is None, container.log.read_text()
    assert start_time(container.process.pid) == before
    assert container.shut_down() == 0, container.log.read_text()
