"""The sweep of shared memory, with real participants, alive and killed."""

from __future__ import annotations

import asyncio
import ctypes
import fcntl
import mmap
import os
import re
import signal
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import psutil
import pytest

from play_launch.container.ros import spawn_guard
from play_launch.process.child import Child, spawn
from play_launch.process.guard import SessionGuard
from play_launch.ros.fastdds.shared_memory import (
    SHARED_MEMORY,
    SweepReport,
    sweep,
    sweep_shared_memory,
)
from play_launch.supervisor.events import Stream
from tests.process.programs import READY_THEN_SLEEP, Output, python

if TYPE_CHECKING:
    from collections.abc import Iterator

# Others would sweep what is to be swept here.
pytestmark = [pytest.mark.anyio, pytest.mark.alone]

NODE = """
import sys, rclpy
from std_msgs.msg import String
name = sys.argv[1]
rclpy.init()
node = rclpy.create_node(name)
publisher = node.create_publisher(String, 'shm_test', 10)
heard = set()
def hear(message):
    if message.data not in heard:
        heard.add(message.data)
        print('heard', message.data, flush=True)
node.create_subscription(String, 'shm_test', hear, 10)
node.create_timer(0.05, lambda: publisher.publish(String(data=name)))
print('up', flush=True)
try:
    rclpy.spin(node)
except BaseException:
    pass
"""


@pytest.fixture
def session() -> Iterator[SessionGuard]:
    guarding = SessionGuard.start(spawn_guard())
    yield guarding
    guarding.close()


NAME = re.compile("fast(?:rtps|dds)_")


def files() -> set[str]:
    return {path.name for path in SHARED_MEMORY.iterdir() if NAME.search(path.name)}


def held_by(pid: int) -> set[str]:
    """Files that a participant owns: its locks, and what belongs to them."""
    owned = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        lock = entry.readlink()
        match = re.fullmatch(r"(fast(?:rtps|dds)_\w+?)_[es]l", lock.name)
        if match:
            owned |= {match[1], lock.name}
            if "port" in match[1]:
                owned.add(f"sem.{match[1]}_mutex")
    return owned


def held_by_others() -> set[str]:
    held: set[str] = set()
    for process in psutil.process_iter():
        with suppress(OSError):  # it ends meanwhile
            held |= held_by(process.pid)
    return held


async def node(session: SessionGuard, name: str) -> tuple[Child, Output]:
    output = Output()
    child = await spawn(
        [sys.executable, "-c", NODE, name], env=dict(os.environ), guard=session, on_output=output
    )
    return child, output


async def end(child: Child, number: signal.Signals = signal.SIGKILL) -> None:
    child.signal_group(number)
    await child.gone()


@pytest.fixture
def loose_names() -> tuple[str, str]:
    """Names of a segment and of a port that no participant has."""
    unique = os.getpid() * 1000 + len(files())
    return f"fastrtps_{unique:016x}", f"fastrtps_port{60000 + os.getpid() % 5000}"


async def test_the_dead_are_swept_and_the_living_go_on_talking(session: SessionGuard) -> None:
    alive, alive_hears = await node(session, "alive")
    dead, dead_hears = await node(session, "dead")
    await alive_hears.wait_line("heard dead")
    await dead_hears.wait_line("heard alive")
    of_alive, of_dead = held_by(alive.pid), held_by(dead.pid)
    assert len(of_alive) == len(of_dead) == 8, "one segment with a lock, two ports with a lock each"
    assert of_alive | of_dead <= files()
    await end(dead)
    assert of_dead <= files(), "a killed process leaves its files"

    report = await sweep_shared_memory()

    assert of_dead <= set(report.removed)
    assert not of_dead & files()
    assert of_alive <= files()
    assert not report.failed
    # A new participant gets the port numbers of the dead one, which the living one still knows.
    new, new_hears = await node(session, "new")
    await new_hears.wait_line("heard alive")
    await alive_hears.wait_line("heard new")
    assert held_by(new.pid) & of_dead, "the case this is about: the same ports"
    await end(new, signal.SIGINT)
    await end(alive)
    await sweep_shared_memory()
    # Ports from 7000 on are those of all domains: another test's process may have one by now.
    assert not ((of_alive | of_dead) - held_by_others()) & files()


async def test_a_sender_gives_up_a_dead_port_that_looks_healthy(session: SessionGuard) -> None:
    alive, _ = await node(session, "alive")
    dead, dead_hears = await node(session, "dead")
    await dead_hears.wait_line("heard alive")
    of_dead = held_by(dead.pid)
    await end(dead)
    for name in of_dead:
        if match := re.fullmatch(r"fast(?:rtps|dds)_port(\d+)", name):
            killed_between_messages(name, int(match[1]))

    await sweep_shared_memory()
    new, new_hears = await node(session, "new")
    await new_hears.wait_line("heard alive")

    assert held_by(new.pid) & of_dead, "the case this is about: the same ports"
    await end(new)
    await end(alive)
    await sweep_shared_memory()


def killed_between_messages(name: str, number: int) -> None:
    """Let it look so: none waits, and the senders' checks do not find the port dead."""
    with (SHARED_MEMORY / name).open("r+b") as file:
        memory = mmap.mmap(file.fileno(), 4096)
        of_number = memory.find(number.to_bytes(4, sys.byteorder))
        last_check_ms = (time.time_ns() // 1_000_000 + 3_600_000).to_bytes(8, sys.byteorder)
        memory[of_number - 20 : of_number - 12] = last_check_ms
        memory[of_number + 20 : of_number + 24] = bytes(4)
        memory.close()


async def test_participants_that_start_and_end_are_not_disturbed(session: SessionGuard) -> None:
    stop = threading.Event()
    reports: list[SweepReport] = []

    def sweep_without_pause() -> None:
        while not stop.is_set():
            reports.append(sweep())

    sweeping = asyncio.create_task(asyncio.to_thread(sweep_without_pause))
    names = [f"node{number}" for number in range(4)]
    nodes = [await node(session, name) for name in names]
    try:
        for _, output in nodes:
            for name in names:
                await output.wait_line(f"heard {name}")
        for name, (child, output) in zip(names, nodes, strict=True):
            owned = held_by(child.pid)
            assert len(owned) == 8, (name, owned)
            assert owned <= files()
            assert not output.texts(Stream.STDERR)
    finally:
        for number, (child, _) in enumerate(nodes):
            await end(child, signal.SIGKILL if number % 2 else signal.SIGINT)
        stop.set()
        await sweeping
    assert not any(report.failed for report in reports)
    await sweep_shared_memory()


async def test_a_port_without_a_lock_lives_while_a_process_maps_it(
    session: SessionGuard,
    loose_names: tuple[str, str],
) -> None:
    _, port = loose_names
    path = SHARED_MEMORY / port
    path.write_bytes(bytes(4096))
    output = Output()
    code = (
        f"import mmap; f = open({str(path)!r}, 'r+b'); m = mmap.mmap(f.fileno(), 0); f.close();"
        "print('ready', flush=True); import time; time.sleep(600)"
    )
    child = await spawn(python(code), env={}, guard=session, on_output=output)
    await output.wait_line("ready")
    assert port not in (await sweep_shared_memory()).removed
    assert path.exists()
    await end(child)
    # Its semaphore was missing: it was made for the time of the sweep.
    assert (await sweep_shared_memory()).removed.count(port) == 1
    assert not {port, f"sem.{port}_mutex"} & files()


async def test_a_segment_without_a_lock_lives_while_a_process_maps_it(
    loose_names: tuple[str, str],
) -> None:
    segment, _ = loose_names
    path = SHARED_MEMORY / segment
    path.write_bytes(bytes(4096))
    with path.open("r+b") as file, mmap.mmap(file.fileno(), 0):
        assert segment not in (await sweep_shared_memory()).removed
    assert (await sweep_shared_memory()).removed.count(segment) == 1


async def test_a_lock_that_is_held_keeps_everything(loose_names: tuple[str, str]) -> None:
    for name in loose_names:
        owned = {name, f"{name}_el"}
        for part in owned:
            (SHARED_MEMORY / part).write_bytes(b"")
        with (SHARED_MEMORY / f"{name}_el").open() as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            await sweep_shared_memory()
            assert owned <= files()
        await sweep_shared_memory()
        assert not owned & files()


async def test_a_shared_lock_counts(loose_names: tuple[str, str]) -> None:
    _, port = loose_names
    owned = {port, f"{port}_sl"}
    for part in owned:
        (SHARED_MEMORY / part).write_bytes(b"")
    with (SHARED_MEMORY / f"{port}_sl").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)
        await sweep_shared_memory()
        assert owned <= files()
    await sweep_shared_memory()
    assert not owned & files()


HOLD_SEMAPHORE = """
import ctypes, sys, time
libc = ctypes.CDLL(None)
libc.sem_open.restype = ctypes.c_void_p
libc.sem_trywait.argtypes = [ctypes.c_void_p]
semaphore = libc.sem_open(sys.argv[1].encode(), 0o100, 0o644, 1)
assert libc.sem_trywait(semaphore) == 0
print('ready', flush=True)
time.sleep(600)
"""


async def test_a_port_that_is_being_opened_is_left_alone(
    session: SessionGuard, loose_names: tuple[str, str]
) -> None:
    _, port = loose_names
    owned = {port, f"{port}_el", f"sem.{port}_mutex"}
    output = Output()
    opener = await spawn(
        [*python(HOLD_SEMAPHORE), f"/{port}_mutex"], env={}, guard=session, on_output=output
    )
    await output.wait_line("ready")
    for part in (port, f"{port}_el"):
        (SHARED_MEMORY / part).write_bytes(b"")
    await sweep_shared_memory()
    assert owned <= files()
    # Killed in the middle of it: every opener of the port would wait for 20 s now. (Any other
    # session of the machine may remove it first.)
    await end(opener)
    await sweep_shared_memory()
    assert not owned & files()


async def test_a_semaphore_that_is_left_alone_works_afterwards(
    session: SessionGuard,
    loose_names: tuple[str, str],
) -> None:
    _, port = loose_names
    output = Output()
    code = HOLD_SEMAPHORE.replace("assert libc.sem_trywait(semaphore) == 0", "")
    user = await spawn([*python(code), f"/{port}_mutex"], env={}, guard=session, on_output=output)
    await output.wait_line("ready")
    # Free, but mapped: another process is about to take it.
    await sweep_shared_memory()
    assert f"sem.{port}_mutex" in files()
    libc = ctypes.CDLL(None)
    libc.sem_open.restype = ctypes.c_void_p
    for function in (libc.sem_trywait, libc.sem_close):
        function.argtypes = [ctypes.c_void_p]
    semaphore = libc.sem_open(f"/{port}_mutex".encode(), 0)
    assert libc.sem_trywait(semaphore) == 0
    assert libc.sem_trywait(semaphore) == -1
    libc.sem_close(semaphore)
    await end(user)
    await sweep_shared_memory()
    assert not {port, f"sem.{port}_mutex"} & files()


async def test_a_process_that_cannot_be_looked_into_holds_nothing_up(
    session: SessionGuard, loose_names: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its page tables are locked while it waits for a disk, as that of a dead NFS server."""
    _, port = loose_names
    output = Output()
    stuck = await spawn(python(READY_THEN_SLEEP), env={}, guard=session, on_output=output)
    await output.wait_line("ready")
    goes_on, readers = threading.Event(), []
    read = Path.read_bytes

    def read_bytes(path: Path) -> bytes:
        if path == Path(f"/proc/{stuck.pid}/maps"):
            readers.append(threading.current_thread())
            goes_on.wait()
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", read_bytes)
    owned, unsure = {port, f"{port}_el"}, f"{port}7"
    for part in (*owned, unsure):
        (SHARED_MEMORY / part).write_bytes(b"")
    try:
        removed = [name for _ in range(3) for name in (await sweep_shared_memory()).removed]
        assert not owned & files(), "its lock, which nothing holds, is proof enough"
        assert unsure not in removed, "the one that cannot be looked into may use it"
        assert len(readers) == 1
        assert readers[0].daemon, "the end of the program waits for the others"
    finally:
        goes_on.set()
        await end(stuck)
    await asyncio.to_thread(readers[0].join)
    await sweep_shared_memory()
    assert unsure not in files()


async def test_other_files_are_none_of_our_business(tmp_path: Path) -> None:
    foreign = SHARED_MEMORY / f"fastrtps_not_ours_{os.getpid()}"
    foreign.touch()
    try:
        await sweep_shared_memory()
        assert foreign.exists()
    finally:
        foreign.unlink()
