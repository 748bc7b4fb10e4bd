"""The guard of a session ends everything that came of it, whatever it did to get away."""

from __future__ import annotations

import asyncio
import errno
import os
import select
import shutil
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import psutil
import pytest

from play_launch.process.cgroups.group import Group
from play_launch.process.child import spawn
from play_launch.process.exit import Exit
from play_launch.process.guard import SessionGuard, SpawnError
from play_launch.supervisor.events import Stream
from tests.process.programs import Output, environment, python, shell
from tests.support.control_groups import control_group
from tests.support.replay import alive
from tests.support.slow_programs import slow_to_execute
from tests.support.system_calls import CLOSE_RANGE, CLOSE_RANGE_CLOEXEC, refusing
from tests.support.waiting import until

# Each prints the pids of what it leaves, then "ready".
ESCAPES = {
    "a shell with jobs": """
        import subprocess
        for _ in range(3):
            print(subprocess.Popen(["sleep", "600"]).pid)
    """,
    "setsid": """
        import subprocess
        print(subprocess.Popen(["setsid", "sleep", "600"]).pid)
    """,
    "a fork without exec": """
        import time
        if (pid := os.fork()) == 0:
            time.sleep(600)
        print(pid)
    """,
    "a daemon without environment": """
        import time
        read, write = os.pipe()
        if os.fork() == 0:
            os.setsid()
            if os.fork() == 0:
                os.write(write, b"%d\\n" % os.getpid())
                os.close(1); os.close(2)
                os.execve("/bin/sleep", ["sleep", "600"], {})
            os._exit(0)
        print(os.read(read, 20).decode().strip())
    """,
    "no death with its parent": """
        import ctypes
        ctypes.CDLL(None).prctl(1, 0, 0, 0, 0)
        for number in range(1, 32):
            if number not in (9, 19):
                signal.signal(number, signal.SIG_IGN)
        print(os.getpid())
    """,
}


def escaping(how: str) -> list[str]:
    code = textwrap.dedent(ESCAPES[how])
    ready = "print('ready', flush=True)\nimport time\ntime.sleep(600)"
    return python(f"import os, signal\n{code}\n{ready}")


async def escaped(guard: SessionGuard, how: str) -> list[psutil.Process]:
    output = Output()
    await spawn(escaping(how), env=environment(), guard=guard, on_output=output)
    await output.wait_line("ready")
    return [psutil.Process(int(text)) for text in output.texts() if text.isdecimal()]


def supervisor_with_a_last_command(guard: Path, mark: Path, end: str) -> int:
    """Run one that starts a process and ends in this way; return its exit status."""
    code = f"""
import os, sys
from pathlib import Path
from play_launch.process.guard import SessionGuard
guard = SessionGuard.start(Path({str(guard)!r}), afterwards=["touch", {str(mark)!r}])
{end}
"""
    return subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode


def test_a_last_command_is_for_a_supervisor_that_died(guard: Path, tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    assert supervisor_with_a_last_command(guard, mark, "guard.close()") == 0
    # A guard that is closed has ended before the supervisor has.
    assert not mark.exists()
    killed = supervisor_with_a_last_command(guard, mark, "os.kill(os.getpid(), 9)")
    assert killed == -signal.SIGKILL
    until(mark.exists, "what the last command does")


def test_the_control_group_of_a_supervisor_that_died_is_removed(guard: Path) -> None:
    with control_group() as base:
        left, kept = (base / name / "below" for name in ("left", "kept"))
        for each in (left, kept):
            each.mkdir(parents=True)
        code = f"""
import os, sys
from pathlib import Path
from play_launch.process.guard import SessionGuard
guard = SessionGuard.start(Path({str(guard)!r}))
guard.entrust(Path({str(left.parent)!r}))
if "order" in sys.argv:
    guard.close()
else:
    os.kill(os.getpid(), 9)
"""
        # No process's child, so nothing but the group leads to it.
        with subprocess.Popen(["sleep", "600"]) as sleeper:
            Group(left).move_here([sleeper.pid])
            subprocess.run([sys.executable, "-c", code, "order"], check=True, timeout=60)
            assert left.exists(), "a supervisor that ends in order removes them itself"
            subprocess.run([sys.executable, "-c", code], check=False, timeout=60)
            until(lambda: not left.parent.exists(), "its removal")
            assert sleeper.wait(60) == -signal.SIGKILL
        assert kept.exists()


@pytest.mark.anyio
async def test_a_process_that_cannot_enter_a_required_group_does_not_run(
    session: SessionGuard,
) -> None:
    for word, status in (("cgroup", 0), ("required_cgroup", 125)):
        output = Output()
        child = await spawn(
            ["echo", "here"],
            env=environment(),
            guard=session,
            on_output=output,
            settings=[f"{word} /no/such/group"],
        )
        assert (await child.gone()).code == status
        assert output.texts() == ([] if status else ["here"])
        said = "cannot enter the required control group /no/such/group: No such file or directory"
        assert output.texts(Stream.STDERR) == ([said] if status else [])


@pytest.mark.anyio
async def test_a_process_that_ends_with_its_channel_has_time_for_that(
    guard: Path, tmp_path: Path
) -> None:
    session = SessionGuard.start(guard)
    mark = tmp_path / "left"
    read_end, write_end = os.pipe()
    leaver = await spawn(
        python(f"import os, time; os.read({read_end}, 1); time.sleep(0.1); open('{mark}', 'w')"),
        env=environment(),
        guard=session,
        descriptors={read_end: read_end},
        leaves_by_itself=True,
    )
    stubborn = await spawn(
        shell("sleep 600"), env=environment(), guard=session, leaves_by_itself=True
    )
    os.close(read_end)
    os.close(write_end)
    await asyncio.to_thread(session.close)
    assert mark.exists()
    assert not psutil.pid_exists(stubborn.pid)
    assert (await leaver.gone()).is_lost, "no process answers"
    await stubborn.gone()


@pytest.mark.anyio
async def test_orphans_do_not_stay_as_zombies(session: SessionGuard) -> None:
    output = Output()
    child = await spawn(
        shell("(sleep 0.05 & echo $!); echo ready; exec sleep 600"),
        env=environment(),
        guard=session,
        on_output=output,
    )
    await output.wait_line("ready")
    orphan = int(output.texts()[0])
    pidfd = os.pidfd_open(orphan)
    await asyncio.to_thread(select.select, [pidfd], [], [], 10)
    os.close(pidfd)
    while psutil.pid_exists(orphan):
        await asyncio.sleep(0.01)
    child.send_signal(signal.SIGKILL)
    assert await child.gone() == Exit(signal=9)


@pytest.mark.skipif(
    not Path("/proc/thread-self/children").exists(), reason="this kernel does not list children"
)
@pytest.mark.anyio
async def test_a_death_costs_the_guard_no_look_at_every_process(session: SessionGuard) -> None:
    def reads() -> int:
        text = Path(f"/proc/{session.pid}/io").read_text()
        return int(text.partition("syscr: ")[2].split()[0])

    others = [subprocess.Popen(["sleep", "600"]) for _ in range(100)]
    try:
        before = await asyncio.to_thread(reads)
        child = await spawn(shell("exit 3"), env=environment(), guard=session)
        assert await child.gone() == Exit(code=3)
        assert await asyncio.to_thread(reads) - before < len(others)
    finally:
        for each in others:
            each.kill()
            each.wait()


@pytest.mark.anyio
async def test_a_guard_that_was_killed_takes_its_children_along_and_says_so(guard: Path) -> None:
    session = SessionGuard.start(guard)
    output = Output()
    child = await spawn(
        shell("sleep 600 & echo $!; wait"), env=environment(), guard=session, on_output=output
    )
    member = psutil.Process(int(await output.wait_line("")))
    os.kill(session.pid, signal.SIGKILL)
    assert (await child.gone()).is_lost
    assert not alive([member])
    assert not session.is_alive
    with pytest.raises(SpawnError):
        await spawn(shell("sleep 600"), env=environment(), guard=session)
    session.close()


RECYCLED = """
import asyncio, os, subprocess, sys, time
from pathlib import Path
from play_launch.process.child import spawn
from play_launch.process.guard import SessionGuard
from play_launch.process.identity import read_stat
from play_launch.process.stop import StopPolicy, stop
from tests.process.programs import environment, shell

def recycle(number, script):
    Path("/proc/sys/kernel/ns_last_pid").write_text(str(number - 1))
    return subprocess.Popen(["sh", "-c", script], stdout=subprocess.PIPE, start_new_session=True)

async def main(is_noticed):
    guard = SessionGuard.start(Path(sys.argv[1]))
    child = await spawn(shell("exec sleep 600"), env=environment(), guard=guard)
    os.kill(guard.pid, 9)
    os.waitid(os.P_PID, guard.pid, os.WEXITED | os.WNOWAIT)
    os.waitpid(child.pid, 0)  # we are the init of this namespace, and inherit it
    with child.holding_session():
        if is_noticed:
            assert (await child.wait()).is_lost
        now = time.clock_gettime(time.CLOCK_BOOTTIME)
        while time.clock_gettime(time.CLOCK_BOOTTIME) < now + 2 / os.sysconf("SC_CLK_TCK"):
            pass  # two that start in one tick look the same
        stranger = recycle(child.pid, f"sleep 600 & echo $!; {'exit' if is_noticed else 'wait'}")
        assert stranger.pid == child.pid
        member = int(stranger.stdout.readline())
        if is_noticed:
            stranger.wait()
        assert read_stat(member).group == child.pid
        assert not child.signal_group(15)
        assert await child.members() == []
    assert (await stop(child, StopPolicy())).exit.is_lost
    assert await child.members() == []
    assert read_stat(member).is_alive
    assert is_noticed or stranger.poll() is None
    print("spared")

asyncio.run(main(sys.argv[2] == "True"))
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to choose the numbers of processes")
@pytest.mark.parametrize("is_noticed", [False, True], ids=["before", "after"])
def test_a_group_that_got_the_number_of_a_lost_one_is_spared(guard: Path, is_noticed: bool) -> None:
    """Its number is given to others before its end is noticed, or after that."""
    alone = ["unshare", "--pid", "--fork", "--kill-child", "--mount-proc"]
    command = [*alone, sys.executable, "-c", RECYCLED, str(guard), str(is_noticed)]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    if result.stderr.startswith("unshare: "):
        pytest.skip(f"this kernel permits no PID namespace ({result.stderr.strip()})")
    assert result.stdout == "spared\n", result.stderr


@pytest.mark.anyio
async def test_a_slow_execution_holds_up_neither_its_supervisor_nor_others(
    session: SessionGuard, tmp_path: Path
) -> None:
    program = Path(shutil.copy(shutil.which("sleep") or "", tmp_path))
    with slow_to_execute(program) as waits:
        slow, killed = [
            await spawn([str(program), "600"], env=environment(), guard=session) for _ in range(2)
        ]
        await asyncio.to_thread(until, waits, "the execution")
        other = await spawn(shell("exit 3"), env=environment(), guard=session)
        assert await other.gone() == Exit(code=3)
        assert killed.signal_group(signal.SIGKILL)
        assert await killed.gone() == Exit(signal=9)
        assert slow.is_running
    await asyncio.to_thread(
        until, lambda: psutil.Process(slow.pid).exe() == str(program), "the program"
    )
    slow.send_signal(signal.SIGKILL)
    await slow.gone()


@pytest.mark.anyio
async def test_what_a_guard_starts_too_late_is_not_executed_and_its_children_live_on(
    guard: Path, tmp_path: Path
) -> None:
    session = SessionGuard.start(guard)
    child = await spawn(shell("sleep 600"), env=environment(), guard=session)
    session._answer_limit = 0.1  # it is not continued before
    ran = tmp_path / "ran"
    os.kill(session.pid, signal.SIGSTOP)
    with pytest.raises(SpawnError, match="does not answer") as late:
        await spawn(shell(f"touch {ran}; sleep 600"), env=environment(), guard=session)
    assert late.value.errno == errno.ECONNRESET
    assert not session.is_alive
    os.kill(session.pid, signal.SIGCONT)
    # It is started all the same, and ends without having executed anything.
    await asyncio.to_thread(until, lambda: len(children_of(session)) == 2, "the late one")
    (late_one,) = [each for each in children_of(session) if each.pid != child.pid]
    await asyncio.to_thread(until, lambda: not alive([late_one]), "its end")
    assert not ran.exists()
    with pytest.raises(ChildProcessError):
        await session.ended(child.pid)
    assert child.is_running, "the late answer is not taken for that of another request"
    with pytest.raises(SpawnError):
        await spawn(shell("sleep 600"), env=environment(), guard=session)
    child.send_signal(signal.SIGKILL)
    assert (await child.gone()).is_lost
    await asyncio.to_thread(session.close)
    assert not late_one.is_running()


def children_of(session: SessionGuard) -> list[psutil.Process]:
    return psutil.Process(session.pid).children()


@pytest.mark.anyio
async def test_a_guard_that_was_stopped_is_continued(session: SessionGuard) -> None:
    """A node may do that, whose parent it is, or a program that stops everything of a user."""
    os.kill(session.pid, signal.SIGSTOP)
    child = await spawn(shell("exit 3"), env=environment(), guard=session)
    assert await child.gone() == Exit(code=3)
    assert session.is_alive


@pytest.mark.anyio
async def test_closing_a_guard_that_was_stopped_leaves_nothing(guard: Path) -> None:
    session = SessionGuard.start(guard)
    left = await escaped(session, "setsid")
    os.kill(session.pid, signal.SIGSTOP)
    await asyncio.to_thread(session.close)
    assert not alive(left)
    assert not session.is_alive


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("flags", "error"),
    [(CLOSE_RANGE_CLOEXEC, errno.EINVAL), (0, errno.ENOSYS)],
    ids=["5.10", "5.8"],
)
async def test_nothing_is_inherited_before_linux_5_11(
    guard: Path, tmp_path: Path, flags: int, error: int
) -> None:
    session = SessionGuard.start(refusing(guard, tmp_path, CLOSE_RANGE, flags, error))
    output = Output()
    child = await spawn(
        shell("ls /proc/self/fd"), env=environment(), guard=session, on_output=output
    )
    assert await child.gone() == Exit()
    assert output.texts() == ["0", "1", "2", "3"]  # 3 is the folder
    await asyncio.to_thread(session.close)


@pytest.mark.parametrize(
    "words",
    ["", "1", "x -- true", "0 -- true", "1 true true", "--session x", "--session 3 --"],
)
def test_wrong_usage_is_reported(guard: Path, words: str) -> None:
    done = subprocess.run([guard, *words.split()], check=False, capture_output=True, text=True)
    assert done.returncode == 125
    assert "usage" in done.stderr


@pytest.mark.anyio
async def test_what_does_not_fit_is_refused(session: SessionGuard) -> None:
    with pytest.raises(SpawnError, match="null byte"):
        await spawn(["sh", "-c", "exit\0 3"], env=environment(), guard=session)
    large = {**environment(), "LARGE": "x" * 100_000, "EMPTY": "", "LINES": "a\nb=c"}
    output = Output()
    child = await spawn(
        shell('echo "${#LARGE}-$EMPTY-$LINES"'), env=large, guard=session, on_output=output
    )
    assert await child.gone() == Exit()
    assert output.texts() == ["100000--a", "b=c"]
