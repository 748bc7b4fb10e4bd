"""Descendants of a child are found and ended with it, also when it has left its session."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import threading
from pathlib import Path

import psutil
import pytest

from play_launch.process import kin
from play_launch.process.child import Child, spawn
from play_launch.process.guard import SessionGuard
from play_launch.process.kin import mark_of
from play_launch.process.stop import StopPolicy, stop
from tests.process.programs import Output, environment, python, shell
from tests.support.waiting import until

PATIENT = StopPolicy(sigint=60, sigterm=60)

DAEMON = """
    read, write = os.pipe()
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            {before}
            os.write(write, b"%d\\n" % os.getpid())
            os.close(1); os.close(2)
            {daemon}
        os._exit(0)
    os.wait()
    print(os.read(read, 20).decode().strip())
"""
"""Forks twice and calls setsid(2) in between, as daemon(7) says; prints its pid."""


def daemon(then: str, before: str = "") -> str:
    """A program that leaves a daemon behind, which does something before its pid is printed."""
    return DAEMON.format(daemon=then, before=before)


SLEEP = "os.execvp('sleep', ['sleep', '600'])"
DEAF = "[signal.signal(number, signal.SIG_IGN) for number in (1, 2, 15)]"
BELOW = """
    import subprocess
    print(subprocess.Popen(["setsid", "sleep", "600"], env={"PATH": os.environ["PATH"]}).pid)
"""
"""Has a session of its own and no environment, but its parent still lives."""
STAYS = "print('ready', flush=True); time.sleep(600)"


async def started(
    session: SessionGuard, body: str, *, mark: str, then: str = STAYS
) -> tuple[Child, psutil.Process]:
    """Start a child that leaves a process behind, and give both."""
    output = Output()
    child = await spawn(
        python(f"import os, signal, time\n{textwrap.dedent(body)}\n{then}"),
        env=environment(),
        guard=session,
        on_output=output,
        mark=mark,
    )
    async with asyncio.timeout(60):
        await output.wait_line("ready")
    return child, psutil.Process(int(output.texts()[0]))


def is_alive(process: psutil.Process) -> bool:
    return process.is_running() and process.status() != psutil.STATUS_ZOMBIE


@pytest.mark.anyio
@pytest.mark.parametrize(
    "body",
    [daemon(SLEEP), daemon("time.sleep(600)"), BELOW],
    ids=["daemon", "daemon without exec", "below"],
)
async def test_a_stop_ends_what_has_left_the_session(session: SessionGuard, body: str) -> None:
    child, left = await started(session, body, mark="1:/one")
    other, stays = await started(session, daemon(SLEEP), mark="1:/other")
    async with asyncio.timeout(60):
        outcome = await stop(child, PATIENT)
        assert outcome.stragglers == 0, "SIGTERM was enough"
        assert not is_alive(left)
        assert is_alive(stays), "it is that of another child"
        assert other.is_running
        await stop(other, PATIENT)
    assert not is_alive(stays)


@pytest.mark.anyio
async def test_a_daemon_that_is_deaf_is_killed_and_counted(session: SessionGuard) -> None:
    child, left = await started(session, daemon("time.sleep(600)", DEAF), mark="1:/one")
    policy = StopPolicy(sigint=60, sigterm=60, hurried=0.2)
    has_ended = asyncio.Event()
    async with asyncio.timeout(60), asyncio.TaskGroup() as tasks:
        stopping = tasks.create_task(stop(child, policy, hurry=has_ended))
        await child.wait()  # unasked; from then on there is a limit
        has_ended.set()
        outcome = await stopping
    assert outcome.stragglers == 1
    assert not is_alive(left)


@pytest.mark.anyio
async def test_a_daemon_ends_with_a_child_that_ends_by_itself(
    session: SessionGuard, caplog: pytest.LogCaptureFixture
) -> None:
    then = "print('ready', flush=True)"
    child, left = await started(session, daemon(SLEEP), mark="1:/one", then=then)
    async with asyncio.timeout(60):
        assert (await child.gone()).code == 0
    assert not is_alive(left)
    # It may not have become sleep yet.
    assert f" (pid {left.pid}), which is killed" in caplog.text


@pytest.mark.anyio
async def test_a_daemon_ends_with_its_child_although_the_guard_was_killed(guard: Path) -> None:
    session = SessionGuard.start(guard)
    child, left = await started(session, daemon(SLEEP), mark="1:/one")
    os.kill(session.pid, signal.SIGKILL)
    async with asyncio.timeout(60):
        assert (await child.gone()).is_lost
    try:
        assert not is_alive(left)
    finally:
        session.close()
        if left.is_running():
            left.kill()


FOREIGN = """
import asyncio, concurrent.futures.thread, logging, os, sys
from pathlib import Path
from play_launch.process.child import spawn
from play_launch.process.guard import SessionGuard
from tests.process.programs import Output, environment, shell
logging.basicConfig(format="%(message)s")

async def main():
    os.setgroups([]); os.setresgid(65534, 65534, 65534); os.setresuid(65534, 65534, 65534)
    guard = SessionGuard.start(Path(sys.argv[1]))
    # Each has a group of its own, so that killpg(2) reaches neither.
    started = f"{sys.argv[2]} --reuid 0 sleep 600 & root=$!; sleep 600 & echo $root $!"
    output = Output()
    script = f"set -m; {started}; read line < /dev/zero"
    child = await spawn(["bash", "-c", script], env=environment(), guard=guard, on_output=output)
    print(await output.wait_line(""), flush=True)
    sys.stdin.readline()
    child.send_signal(9)
    await child.gone()
    print("gone", flush=True)
    sys.stdin.readline()

asyncio.run(main())
"""
"""An ordinary user's supervisor, one process of whose session has become root's."""


@pytest.mark.skipif(
    os.geteuid() != 0 or "NoNewPrivs:\t0" not in Path("/proc/self/status").read_text(),
    reason="needs root, and that programs may gain privileges (no_new_privs off)",
)
def test_a_process_that_may_not_be_killed_is_named_and_the_others_are_killed(
    guard: Path,
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        setpriv = Path(shutil.copy(shutil.which("setpriv") or "", folder))
        setpriv.parent.chmod(0o755)
        setpriv.chmod(0o4755)
        with subprocess.Popen(
            [sys.executable, "-c", FOREIGN, guard, setpriv],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as supervisor:
            assert supervisor.stdin is not None
            assert supervisor.stdout is not None
            foreign, own = map(int, supervisor.stdout.readline().split())
            try:
                until(lambda: psutil.Process(foreign).uids().real == 0, "its becoming root's")
                supervisor.stdin.write("\n")
                supervisor.stdin.flush()
                assert supervisor.stdout.readline() == "gone\n"
                assert not psutil.pid_exists(own)
                _, log = supervisor.communicate(timeout=60)
                assert f"left sleep (pid {foreign}), which may not be killed" in log
                assert "Error" not in log
            finally:
                psutil.Process(foreign).kill()


@pytest.mark.anyio
async def test_a_daemon_that_cannot_be_looked_into_holds_no_stop_up(
    session: SessionGuard, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The kernel keeps readers of its environment waiting while it waits for a disk itself."""
    other, stuck = await started(session, daemon(SLEEP), mark="1:/stuck")
    child, left = await started(session, daemon(SLEEP), mark="1:/one")
    goes_on, readers = threading.Event(), []

    def read(pid: int) -> str:
        if pid == stuck.pid:
            readers.append(threading.current_thread())
            goes_on.wait()
        return mark_of(pid)

    monkeypatch.setattr(kin, "mark_of", read)
    try:
        async with asyncio.timeout(60):
            await stop(child, PATIENT)
        assert not is_alive(left)
        assert is_alive(stuck)
        assert len(readers) == 1
        assert readers[0].daemon, "the end of the program waits for the others"
        assert f"sleep (pid {stuck.pid}) ends with the session" in caplog.text
        assert caplog.text.count("cannot be read") == 1
    finally:
        goes_on.set()
    async with asyncio.timeout(60):
        await stop(other, PATIENT)


@pytest.mark.anyio
async def test_the_mark_of_a_process_stays_while_another_program_is_executed(
    session: SessionGuard,
) -> None:
    """For a moment, it has no environment."""
    again = 'exec sh -c "$again"'
    output = Output()
    child = await spawn(
        shell(f"echo ready; {again}"),
        env={**environment(), "again": again},
        guard=session,
        on_output=output,
        mark="1:/one",
    )
    await output.wait_line("ready")
    marks = await asyncio.to_thread(lambda: {mark_of(child.pid) for _ in range(5_000)})
    assert marks == {"1:/one"}
    child.send_signal(signal.SIGKILL)
    async with asyncio.timeout(60):
        await child.gone()
