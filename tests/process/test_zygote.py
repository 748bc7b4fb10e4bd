"""A container that a zygote was forked for is like one that was executed."""

from __future__ import annotations

import asyncio
import errno
import os
import re
import resource
import signal
import socket
import subprocess
import sys
import time
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.container.environment import child_environment, find_allocator, for_isolation
from play_launch.container.ros import component_container, ros_installation
from play_launch.process.child import Child, spawn
from play_launch.process.exit import Exit
from play_launch.process.guard import SessionGuard
from play_launch.process.zygote import Zygote, is_loaded_alike, is_read_before_main
from play_launch.supervisor.events import Stream
from tests.process.programs import Output
from tests.support.system_calls import CLOSE_RANGE, CLOSE_RANGE_CLOEXEC, refusing
from tests.support.waiting import LIMIT, until

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterator, Mapping

pytestmark = pytest.mark.anyio
PROGRAM = component_container()


PLAIN = {
    **child_environment(os.environ, ros_installation()),
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
}
ISOLATED = for_isolation(PLAIN, find_allocator().library)


@contextmanager
def zygote_of(session: SessionGuard, environment: Mapping[str, str]) -> Iterator[Zygote]:
    zygote = Zygote.start(session, PROGRAM, environment)
    try:
        # Linking counts as time to answer, of which a busy machine may need too much.
        process = process_of(session)
        until(lambda: waits_for_work(process), "a zygote that is linked")
        yield zygote
    finally:
        zygote.close()


@pytest.fixture(name="zygote")
def _zygote(session: SessionGuard) -> Iterator[Zygote]:
    with zygote_of(session, PLAIN) as zygote:
        yield zygote


def process_of(session: SessionGuard) -> psutil.Process:
    """The zygote itself, once it has been linked."""
    found: list[psutil.Process] = []

    def is_there() -> bool:
        for child in psutil.Process(session.pid).children():
            with suppress(psutil.Error):  # it has just ended
                if child.cmdline()[1:2] == ["--zygote"]:
                    found.append(child)
        return bool(found)

    until(is_there, "a zygote")
    return found[0]


def waits_for_work(zygote: psutil.Process) -> bool:
    """Whether it is in a system call about its socket, and so has done all else."""
    try:
        call = Path(f"/proc/{zygote.pid}/syscall").read_text().split()
    except PermissionError:  # as the kernel is set, nobody may know
        return True
    return len(call) > 1 and int(call[1], 16) == int(zygote.cmdline()[2])


async def has_ended(process: psutil.Process) -> bool:
    async with asyncio.timeout(60):
        while process.is_running():
            await asyncio.sleep(0.005)
    return True


@dataclass
class Running:
    """A container that has said hello."""

    child: Child
    output: Output

    def file(self, name: str) -> str:
        return Path(f"/proc/{self.child.pid}/{name}").read_text(encoding="utf-8")

    def first_address(self) -> str:
        lines = self.file("maps").splitlines()
        return next(line for line in lines if line.endswith(str(PROGRAM))).partition("-")[0]


@asynccontextmanager
async def running(
    session: SessionGuard,
    zygote: Zygote | None,
    *arguments: str,
    environment: Mapping[str, str] | None = None,
) -> AsyncIterator[Running]:
    ours, theirs = socket.socketpair()
    output = Output()
    with ours:
        ours.setblocking(False)
        with theirs:
            child = await spawn(
                [str(PROGRAM), *arguments, "--ros-args", "-r", "__node:=container"],
                env={
                    **(environment or PLAIN),
                    "PLAY_LAUNCH_CONTROL_FD": str(theirs.fileno()),
                },
                guard=session,
                descriptors={theirs.fileno(): theirs.fileno()},
                on_output=output,
                leaves_by_itself=True,
                zygote=zygote,
            )
        async with asyncio.timeout(60):
            assert await asyncio.get_running_loop().sock_recv(ours, 1), output.texts()
        try:
            yield Running(child, output)
        finally:
            child.send_signal(signal.SIGTERM)
            async with asyncio.timeout(60):
                await child.gone()


def descriptors(container: Running) -> list[str]:
    """What is open, without the numbers in the names."""
    entries = Path(f"/proc/{container.child.pid}/fd").iterdir()
    return sorted(re.sub(r"[0-9a-f]{8,}|\d+", "", str(entry.readlink())) for entry in entries)


SAME_IN_STATUS = (
    *("Name", "Umask", "TracerPid", "Uid", "Gid", "FDSize", "Groups", "Threads"),
    *("SigBlk", "SigIgn", "SigCgt", "CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb"),
    *("NoNewPrivs", "Seccomp", "THP_enabled", "Cpus_allowed", "Mems_allowed", "CoreDumping"),
)


def state(container: Running) -> dict[str, Any]:
    status = dict(line.split(":", 1) for line in container.file("status").splitlines())
    stat = container.file("stat").rpartition(")")[2].split()
    process = psutil.Process(container.child.pid)
    # Those of the middleware have the numbers of their ports in their names.
    names = [
        re.sub(r"\d+", "", container.file(f"task/{each.id}/comm").strip())
        for each in process.threads()
    ]
    return {
        **{name: status[name].strip() for name in SAME_IN_STATUS if name in status},
        "limits": container.file("limits"),
        "oom": container.file("oom_score_adj"),
        "filter": container.file("coredump_filter"),
        "cwd": process.cwd(),
        "exe": process.exe(),
        "nice": (stat[15], stat[16]),
        "parent": stat[1],
        "leads": (stat[2], stat[3]) == (str(process.pid),) * 2,
        "tty": stat[4],
        "descriptors": descriptors(container),
        "threads": sorted(names),
    }


async def become_alike(one: Running, other: Running) -> None:
    """Wait until both offer their services: threads and descriptors come one after the other."""
    states: list[dict[str, Any]] = []
    deadline = time.monotonic() + LIMIT
    while not states or states[0] != states[1] or "manager" not in states[0]["threads"]:
        assert not states or time.monotonic() < deadline, states
        with suppress(OSError, psutil.Error):  # of a thread that has just ended
            states = [state(each) for each in (one, other)]
        await asyncio.sleep(0.01)


@pytest.mark.parametrize("arguments", [(), ("--isolated",)], ids=["standard", "isolated"])
async def test_a_fork_is_like_what_was_executed(
    session: SessionGuard, arguments: tuple[str, ...]
) -> None:
    environment = ISOLATED if arguments else PLAIN
    with zygote_of(session, environment) as zygote:
        assert zygote.can_become(str(PROGRAM), environment)
        async with (
            running(session, zygote, *arguments, environment=environment) as forked,
            running(session, zygote, *arguments, environment=environment) as other,
            running(session, None, *arguments, environment=environment) as executed,
        ):
            assert forked.first_address() == other.first_address() != executed.first_address()
            await become_alike(forked, executed)
            await become_alike(other, executed)


@pytest.mark.parametrize(
    ("flags", "error"),
    [(CLOSE_RANGE_CLOEXEC, errno.EINVAL), (0, errno.ENOSYS)],
    ids=["5.10", "5.8"],
)
async def test_a_fork_has_nothing_of_others_before_linux_5_11(
    guard: Path, session: SessionGuard, tmp_path: Path, flags: int, error: int
) -> None:
    older = SessionGuard.start(refusing(guard, tmp_path, CLOSE_RANGE, flags, error))
    try:
        with zygote_of(older, PLAIN) as zygote:
            async with running(older, zygote) as forked, running(session, None) as executed:
                await asyncio.to_thread(
                    until, lambda: descriptors(forked) == descriptors(executed), "the same ones"
                )
                assert zygote.fileno() >= 0, "it was forked"
    finally:
        await asyncio.to_thread(older.close)


async def test_it_shows_its_own_command_and_environment(
    session: SessionGuard, zygote: Zygote
) -> None:
    environment = {**PLAIN, "ONE": "x" * 50_000, "EMPTY": ""}
    async with running(
        session, zygote, "--stop_timeout", "1", environment=environment
    ) as container:
        process = psutil.Process(container.child.pid)
        assert tuple(process.cmdline()) == container.child.argv
        shown = process.environ()
        # What the container has taken out of its own environment stands there as in any process.
        assert {name: shown.get(name) for name in environment} == environment
        assert container.file("comm").strip() == PROGRAM.name[:15]


async def test_output_and_exit_status_are_its_own(session: SessionGuard, zygote: Zygote) -> None:
    for argument, is_good in (("--version", True), ("--nonsense", False)):
        results = []
        for each in (zygote, None):
            output = Output()
            child = await spawn(
                [str(PROGRAM), argument],
                env=PLAIN,
                guard=session,
                on_output=output,
                zygote=each,
            )
            async with asyncio.timeout(60):
                end = await child.gone()
            results.append((end, output.texts(), output.texts(Stream.STDERR)))
        assert results[0] == results[1]
        assert results[0][0].ok == is_good
        assert any(results[0][1:])


async def test_forks_begin_although_the_guard_is_asked_without_a_pause(
    session: SessionGuard, zygote: Zygote
) -> None:
    is_over = False

    async def ask() -> None:
        while not is_over:
            with suppress(ChildProcessError):
                await session.ended(os.getpid())
            await asyncio.sleep(0)

    asking = asyncio.create_task(ask())
    try:
        async with running(session, zygote) as one, running(session, zygote) as other:
            assert {one.first_address()} == {other.first_address()}
    finally:
        is_over = True
        await asking


async def test_the_end_by_a_signal_is_seen(session: SessionGuard, zygote: Zygote) -> None:
    async with running(session, zygote) as container:
        container.child.send_signal(signal.SIGKILL)
        assert await container.child.gone() == Exit(signal=9)


async def test_a_zygote_has_nothing_of_others_and_no_threads_but_those_for_tracing(
    session: SessionGuard, zygote: Zygote
) -> None:
    process = process_of(session)
    async with running(session, zygote):
        # It has closed what the fork got, and waits for the next one.
        until(lambda: waits_for_work(process), "a zygote that has forked")
        open_files = {entry.name for entry in Path(f"/proc/{process.pid}/fd").iterdir()}
        assert open_files == {"0", "1", "2", process.cmdline()[2]}
        assert process.num_threads() in {1, 3}
        assert os.getsid(process.pid) == process.pid
    zygote.close()
    assert await has_ended(process)
    assert not psutil.pid_exists(process.pid)


async def test_a_zygote_that_was_killed_is_done_without(
    session: SessionGuard, zygote: Zygote, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "play_launch")
    async with running(session, zygote) as forked:
        process = process_of(session)
        process.kill()
        assert await has_ended(process)
        async with running(session, zygote) as executed:
            assert executed.first_address() != forked.first_address()
        assert "executed one by one" in caplog.text
        assert not zygote.can_become(str(PROGRAM), PLAIN)


async def test_a_frozen_zygote_is_ended_and_done_without(
    session: SessionGuard, zygote: Zygote, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "play_launch")
    async with running(session, zygote):
        process = process_of(session)
        process.suspend()
        async with running(session, zygote) as executed:
            assert "timed out" in caplog.text
            # It had the container's output and channel already.
            assert await has_ended(process)
            executed.child.send_signal(signal.SIGKILL)
            assert await executed.child.gone() == Exit(signal=9)
        assert [each.pid for each in psutil.Process(session.pid).children()] != [process.pid]


async def test_a_fork_that_is_refused_is_executed(session: SessionGuard, zygote: Zygote) -> None:
    async with running(session, zygote):
        process = process_of(session)
        # No room for the descriptors of another one.
        resource.prlimit(process.pid, resource.RLIMIT_NOFILE, (6, 6))
        async with running(session, zygote) as executed:
            assert "6" not in re.findall(r"open files +(\d+)", executed.file("limits"))


async def test_a_zygote_that_cannot_be_started_is_done_without(session: SessionGuard) -> None:
    environment = {**PLAIN, "LD_LIBRARY_PATH": "/nowhere"}
    missing = Zygote.start(session, Path("/no/such/program"), environment)
    async with running(session, missing) as container:
        assert container.child.is_running
    missing.close()


SUPERVISOR = """
import sys, time
from pathlib import Path
from play_launch.process.guard import SessionGuard
from play_launch.process.zygote import Zygote
from tests.process.test_zygote import PLAIN, PROGRAM, process_of
guard = SessionGuard.start(Path(sys.argv[1]))
zygote = Zygote.start(guard, PROGRAM, PLAIN)
print(process_of(guard).pid, flush=True)
time.sleep(600)
"""


@pytest.mark.parametrize("with_its_guard", [False, True])
def test_a_zygote_ends_with_a_supervisor_that_is_killed(guard: Path, with_its_guard: bool) -> None:
    supervisor = subprocess.Popen(
        [sys.executable, "-c", SUPERVISOR, guard], stdout=subprocess.PIPE, text=True
    )
    assert supervisor.stdout is not None
    process = psutil.Process(int(supervisor.stdout.readline()))
    parent = process.parent()
    assert parent is not None
    supervisor.kill()
    if with_its_guard:
        parent.kill()
    supervisor.communicate()
    _, left = psutil.wait_procs([process, parent], timeout=60)
    for each in left:
        each.kill()
    assert not left


NAMES = st.text(st.characters(codec="ascii", exclude_characters="=\0"), min_size=1)
VALUES = st.text(max_size=3)


@given(NAMES, VALUES, st.dictionaries(NAMES, VALUES))
def test_what_is_read_before_main_makes_the_difference(
    name: str, value: str, others: dict[str, str]
) -> None:
    one = {each: value for each, value in others.items() if each not in {name, "LD_PRELOAD"}}
    other = {**one, name: value}
    assert is_loaded_alike(one, one)
    assert is_loaded_alike(one, other) == is_loaded_alike(other, one)
    assert is_loaded_alike(one, other) != is_read_before_main(name)


@pytest.mark.parametrize(
    ("preloaded", "known"),
    [
        ("", True),
        ("/a b/libmimalloc.so.3", False),
        ("/a/libmimalloc.so.3", True),
        ("libjemalloc.so.2", True),
        ("/a/libmimalloc.so.3:/p/libfastdds_waits.so", True),
        ("/a/libmimalloc.so.3:libasan.so", False),
        ("/lib/libmimalloc-spy.so", False),
    ],
)
def test_what_others_preload_may_read_anything(preloaded: str, known: bool) -> None:
    environment = {"LD_PRELOAD": preloaded}
    assert is_loaded_alike(environment, environment) == known


@pytest.mark.parametrize("environment", [PLAIN, ISOLATED], ids=["standard", "isolated"])
def test_every_variable_that_is_read_before_main_is_known(environment: dict[str, str]) -> None:
    spy = PROGRAM.parents[1] / "libplay_launch_getenv_spy.so"
    preloaded = f"{environment.get('LD_PRELOAD', '')} {spy}".strip()
    done = subprocess.run(
        [PROGRAM, "--version"],
        env={**environment, "LD_PRELOAD": preloaded},
        check=True,
        capture_output=True,
        text=True,
    )
    names = set(done.stderr.split())
    assert "RMW_IMPLEMENTATION" in names, done.stderr
    assert not {name for name in names if not is_read_before_main(name)}
