"""Children: started, watched, and gone without a trace."""

from __future__ import annotations

import asyncio
import os
import re
import resource
import signal
import threading
from contextlib import suppress
from errno import EAGAIN, ENOENT
from pathlib import Path
from unittest.mock import Mock

import psutil
import pytest

from play_launch.process.child import OUTPUT_GRACE, Child, spawn
from play_launch.process.exit import Exit
from play_launch.process.guard import SessionGuard, SpawnError
from play_launch.process.identity import read_stat
from play_launch.supervisor.events import Stream
from tests.process.programs import READY_THEN_SLEEP, Output, environment, exists, python, shell
from tests.support.tracing import stopped_by_a_tracer

pytestmark = pytest.mark.anyio


async def start(argv: list[str], guard: SessionGuard, output: Output | None = None) -> Child:
    return await spawn(argv, env=environment(), guard=guard, on_output=output)


async def finished(child: Child) -> Exit:
    end = await child.gone()
    assert not exists(child.pid)
    return end


async def test_an_exit_status_is_told(session: SessionGuard) -> None:
    child = await start(shell("exit 7"), session)
    assert child.is_running
    assert await child.wait() == Exit(code=7)
    assert await finished(child) == Exit(code=7)
    assert child.exit == Exit(code=7)
    assert "exited with status 7" in repr(child)


async def test_a_child_has_its_own_session_and_identity(session: SessionGuard) -> None:
    child = await start(shell("exec sleep 600"), session)
    stat = read_stat(child.pid)
    assert stat.session == stat.group == child.pid
    assert stat.start_time == child.start_time
    assert stat.parent == session.pid
    assert child.send_signal(signal.SIGTERM)
    assert await finished(child) == Exit(signal=signal.SIGTERM)
    # From here on the number may be another process's.
    assert not child.send_signal(signal.SIGTERM)
    assert not child.signal_group(signal.SIGTERM)
    assert await child.members() == []


async def test_a_child_gets_its_environment_and_directory_and_nothing_else(
    session: SessionGuard, tmp_path: Path
) -> None:
    read_end, write_end = os.pipe()
    inheritable, other = os.pipe()
    os.set_inheritable(inheritable, True)
    os.set_inheritable(other, True)
    output = Output()
    code = (
        "import os; print('cwd', os.getcwd()); print('env', os.environ['COLOUR'], len(os.environ));"
        f"os.write({write_end}, b'hello');"
        "print('fds', *sorted(int(n) for n in os.listdir('/proc/self/fd')));"
        "print('stdin', os.readlink('/proc/self/fd/0'))"
    )
    child = await spawn(
        python(code),
        env={"COLOUR": "red", "LC_CTYPE": "C.UTF-8"},
        guard=session,
        cwd=tmp_path,
        descriptors={write_end: write_end},
        on_output=output,
    )
    assert (await finished(child)).ok, output.texts(Stream.STDERR)
    assert os.read(read_end, 10) == b"hello"
    lines = dict(text.split(" ", 1) for text in output.texts())
    assert lines["cwd"] == str(tmp_path)
    assert lines["env"] == "red 2"
    assert lines["stdin"] == "/dev/null"
    # 3 is the directory it lists.
    assert lines["fds"].split() == ["0", "1", "2", "3", str(write_end)]
    for descriptor in (read_end, write_end, inheritable, other):
        os.close(descriptor)


async def test_all_output_arrives_before_a_child_is_gone(session: SessionGuard) -> None:
    output = Output()
    code = (
        "import sys\n"
        "for n in range(20000): print('out', n)\n"
        "for n in range(2000): print('err', n, file=sys.stderr)\n"
        "sys.stdout.write('no line end'); sys.stdout.flush(); import os; os.abort()"
    )
    end = await finished(await start(python(code), session, output))
    assert end.signal == signal.SIGABRT
    assert output.texts() == [f"out {n}" for n in range(20000)] + ["no line end"]
    assert output.texts(Stream.STDERR) == [f"err {n}" for n in range(2000)]


async def test_ignored_and_blocked_signals_are_not_inherited(guard: Path) -> None:
    before = signal.signal(signal.SIGUSR1, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGUSR2])
    session = SessionGuard.start(guard)
    try:
        output = Output()
        code = (
            "for line in open('/proc/self/status'):\n"
            "  if line.startswith(('SigBlk', 'SigIgn')): print(line.strip())"
        )
        await finished(await start(python(code), session, output))
    finally:
        signal.signal(signal.SIGUSR1, before)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGUSR2])
        await session.end()
    # Python itself ignores SIGPIPE and SIGXFSZ; posix_spawn the two of glibc, which stay so.
    pythons = (1 << (signal.SIGPIPE - 1)) | (1 << (signal.SIGXFSZ - 1))
    blocked, ignored = (int(line.partition("\t")[2], 16) for line in output.texts())
    assert (blocked, ignored & ~(0b11 << 31)) == (0, pythons)


async def test_an_ignored_sigchld_does_not_swallow_the_status(guard: Path) -> None:
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    session = SessionGuard.start(guard)
    try:
        assert await finished(await start(shell("exit 3"), session)) == Exit(code=3)
    finally:
        signal.signal(signal.SIGCHLD, before)
        await session.end()


async def test_a_death_that_a_tracer_keeps_to_itself_is_not_asked_for_all_the_time(
    session: SessionGuard,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """As `gdb -p` at its prompt does; the pidfd is readable, and the parent is told nothing."""
    asked = Mock(side_effect=session.ended)
    monkeypatch.setattr(session, "ended", asked)
    child = await start(python(READY_THEN_SLEEP), session, output := Output())
    await output.wait_line("ready")
    with stopped_by_a_tracer(child.pid) as tracer:
        assert child.send_signal(signal.SIGKILL)
        while not asked.called:
            await asyncio.sleep(0)
        for _ in range(1000):
            await asyncio.sleep(0)
        assert asked.call_count < 100
        while "traces it" not in caplog.text:
            await asyncio.sleep(0.01)
        assert child.is_running
    assert await finished(child) == Exit(signal=9)
    assert f"(pid {child.pid}) has died, but python" in caplog.text
    assert f"(pid {tracer}) traces it" in caplog.text


async def test_no_thread_per_child_and_nothing_left_of_many(session: SessionGuard) -> None:
    outputs = [Output() for _ in range(40)]
    threads = threading.active_count()
    children = [await start(python(READY_THEN_SLEEP), session, output) for output in outputs]
    for output in outputs:
        await output.wait_line("ready")
    async with asyncio.timeout(10):
        while threading.active_count() > threads:  # one that looked a program up may be ending
            await asyncio.sleep(0.01)
    for child in children:
        child.signal_group(signal.SIGKILL)
    for child in children:
        assert await finished(child) == Exit(signal=signal.SIGKILL)


async def test_grandchildren_die_with_their_parent(session: SessionGuard) -> None:
    output = Output()
    # Two in its group, one in a group of its own (a job of an interactive shell).
    script = (
        "sleep 600 & sleep 601 & set -m; sleep 602 & echo pids $(jobs -p); echo done; kill -9 $$"
    )
    child = await start(["/bin/bash", "-c", script], session, output)
    assert (await finished(child)).signal == signal.SIGKILL
    pids = [int(pid) for pid in (await output.wait_line("pids")).split()]
    assert len(pids) == 3
    # No process of ours waits for orphans, so "dead" is what can be asked for.
    for pid in pids:
        assert not exists(pid) or not read_stat(pid).is_alive


async def test_an_escaped_grandchild_does_not_hold_up_the_end(
    session: SessionGuard, caplog: pytest.LogCaptureFixture
) -> None:
    output = Output()
    code = (
        "import subprocess;"
        "p = subprocess.Popen(['sleep', '600'], start_new_session=True); print('pid', p.pid)"
    )
    child = await start(python(code), session, output)
    await child.wait()
    ended = asyncio.get_running_loop().time()
    assert (await finished(child)).ok
    assert asyncio.get_running_loop().time() - ended >= OUTPUT_GRACE
    pid = int(await output.wait_line("pid"))
    assert read_stat(pid).is_alive
    assert "keeps its output open" in caplog.text
    os.kill(pid, signal.SIGKILL)


@pytest.mark.parametrize(
    ("argv", "errno", "text"),
    [
        (["no-such-program"], 2, "cannot start no-such-program: no such program in PATH"),
        (["/no/such/program"], 2, "cannot start /no/such/program: no such file"),
        (["/etc/passwd"], 13, "cannot start /etc/passwd: it is not an executable file"),
        (["/tmp"], 13, "it is not an executable file"),
        ([""], 0, "the command line is empty"),
        ([], 0, "cannot start a program without a name"),
        (["/bin/sh", "-c", "\0"], 0, "embedded null byte"),
    ],
)
async def test_what_cannot_start_is_said(
    session: SessionGuard, argv: list[str], errno: int, text: str
) -> None:
    with pytest.raises(SpawnError) as caught:
        await start(argv, session, Output())
    assert text in str(caught.value)
    assert caught.value.errno == errno
    assert caught.value.argv == tuple(argv)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        (b"#!/no/such/python3 -u\n", "names /no/such/python3 to run it, which is missing"),
        (b"#!/etc/passwd\0\n", "which is missing or no program"),
        (b"#!/etc/passwd\n", "which is missing or no program"),
        (b"#!/usr/bin/env python3\r\n", r"with CR LF; fix: sed -i 's/\r$//'"),
        (b"#! /bin/sh\r\n", r"with CR LF; fix: sed -i 's/\r$//'"),
        (b"#!/bin/echo -n\r\n", ""),
        (b"#! /bin/sh\n", ""),
        (b"#!/bin/sh", ""),
        (b"#!\n", ""),
        (b"", ""),
    ],
)
async def test_a_script_whose_first_line_cannot_run_it_is_named(
    session: SessionGuard, tmp_path: Path, line: bytes, text: str
) -> None:
    script = tmp_path / "talker.py"
    script.write_bytes(line)
    script.chmod(0o755)
    in_path = {"PATH": str(tmp_path)}
    for argv, variables in ([str(script)], environment()), ([script.name], in_path):
        if text:
            with pytest.raises(SpawnError, match=re.escape(text)) as caught:
                await spawn(argv, env=variables, guard=session)
            assert caught.value.errno == ENOENT
        else:
            child = await spawn(argv, env=variables, guard=session)
            assert await finished(child) == Exit(code=0)


async def test_without_another_thread_nothing_is_started_for_now(
    session: SessionGuard, monkeypatch: pytest.MonkeyPatch
) -> None:
    def start(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", start)
    with pytest.raises(SpawnError, match="no thread can be started") as caught:
        await spawn(["true"], env=environment(), guard=session)
    assert caught.value.errno == EAGAIN


async def test_a_directory_that_went_away_is_said(
    session: SessionGuard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("play_launch.process.child.check_program", lambda *_: None)
    output = Output()
    missing = tmp_path / "missing"
    child = await spawn(
        shell("true"), env=environment(), guard=session, cwd=missing, on_output=output
    )
    assert await finished(child) == Exit(code=126)
    assert output.texts(Stream.STDERR) == [
        f"spawn_guard: cannot enter {missing}: No such file or directory"
    ]


async def test_terminals_are_emulated(session: SessionGuard) -> None:
    output = Output()
    code = (
        "import os, sys; print(os.isatty(0), os.isatty(1), os.isatty(2), os.getsid(0));"
        "print('err', file=sys.stderr); os.open('/dev/tty', os.O_RDWR)"
    )
    child = await spawn(
        python(code), env=environment(), guard=session, on_output=output, emulate_tty=True
    )
    # It has no controlling terminal: no ^C and no hang-up from there.
    assert await finished(child) == Exit(code=1)
    assert output.texts() == [f"False True True {child.pid}"]
    errors = output.texts(Stream.STDERR)
    assert errors[0] == "err"
    assert "/dev/tty" in errors[-1]


async def test_all_that_is_written_to_a_terminal_arrives_as_it_is(session: SessionGuard) -> None:
    output = Output()
    code = "import sys; [print(f'{n}\\t\\x1b[31m' + 'x' * 90) for n in range(5000)]"
    child = await spawn(
        python(code), env=environment(), guard=session, on_output=output, emulate_tty=True
    )
    assert (await finished(child)).ok
    assert output.texts() == [f"{n}\t\x1b[31m" + "x" * 90 for n in range(5000)]


async def test_a_program_without_its_loader_ends_with_127(
    session: SessionGuard, tmp_path: Path
) -> None:
    program = tmp_path / "node"
    program.write_bytes(Path("/bin/true").read_bytes().replace(b"/ld-linux", b"/no-linux"))
    program.chmod(0o755)
    output = Output()
    assert await finished(await start([str(program)], session, output)) == Exit(code=127)
    assert "No such file" in output.texts(Stream.STDERR)[0]


async def test_too_many_open_files_leave_nothing_behind(session: SessionGuard) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, hard))
    filling: list[int] = []
    failures = 0
    try:
        with suppress(OSError):
            while True:
                filling.append(os.open(os.devnull, os.O_RDONLY))
        # Each step has one descriptor more to go on with before it fails.
        child = None
        while child is None:
            with suppress(SpawnError):
                child = await start(shell("exit 4"), session, Output())
            if child is None:
                with pytest.raises(SpawnError, match="Too many open files") as caught:
                    await start(shell("exit 4"), session, Output())
                assert caught.value.errno == 24
                failures += 1
                os.close(filling.pop())
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        for descriptor in filling:
            os.close(descriptor)
    assert await finished(child) == Exit(code=4)
    assert failures >= 5
    assert psutil.Process(session.pid).children() == []


@pytest.mark.parametrize(
    ("end", "text"),
    [
        (Exit(), "exited with status 0"),
        (Exit(code=3), "exited with status 3"),
        (Exit(signal=11), "exited with signal 11 (SIGSEGV)"),
        (Exit(signal=6, core_dumped=True), "exited with signal 6 (SIGABRT, core dumped)"),
        (
            Exit(signal=signal.SIGRTMIN + 2),
            f"exited with signal {signal.SIGRTMIN + 2} (SIGRTMIN+2)",
        ),
        (Exit.lost(), "ended, with an unknown exit status"),
    ],
)
def test_an_end_is_told_in_words(end: Exit, text: str) -> None:
    assert str(end) == text
    assert repr(end) == f"<Exit: {text}>"
