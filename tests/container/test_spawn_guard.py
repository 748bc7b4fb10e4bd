"""spawn_guard becomes the command, unless its parent is gone."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from play_launch.container.ros import spawn_guard


@pytest.fixture(name="guard")
def _guard() -> str:
    if "PLAY_LAUNCH_CONTAINER" in os.environ:
        return str(Path(os.environ["PLAY_LAUNCH_CONTAINER"]).with_name("spawn_guard"))

    return str(spawn_guard())


def run(guard: str, *arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    done: subprocess.CompletedProcess[str] = subprocess.run(
        [guard, *arguments], check=False, capture_output=True, text=True, **options
    )
    return done


def test_the_command_runs_with_its_arguments(guard: str) -> None:
    done = run(guard, str(os.getpid()), "--", "echo", "a b", "--", "c")
    assert (done.returncode, done.stdout) == (0, "a b -- c\n")


def test_its_status_is_that_of_the_command(guard: str) -> None:
    assert run(guard, str(os.getpid()), "--", "sh", "-c", "exit 42").returncode == 42


def test_nothing_runs_without_the_parent(guard: str) -> None:
    done = run(guard, str(os.getppid()), "--", "echo", "alive")
    assert (done.returncode, done.stdout) == (125, "")
    assert str(os.getppid()) in done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("1",),
        ("x", "--", "true"),
        ("0", "--", "true"),
        ("1", "true", "true"),
        ("--session", "x"),
        ("--session", "3", "--"),
        ("--session", "3", "true", "true"),
    ],
)
def test_wrong_usage_is_told(guard: str, arguments: tuple[str, ...]) -> None:
    done = run(guard, *arguments)
    assert done.returncode == 125
    assert "usage" in done.stderr


def test_a_missing_command_is_told(guard: str, tmp_path: Path) -> None:
    done = run(guard, str(os.getpid()), "--", "/no/such/command")
    assert done.returncode == 127
    assert "/no/such/command" in done.stderr
    plain = tmp_path / "plain"
    plain.write_text("no program")
    assert run(guard, str(os.getpid()), "--", str(plain)).returncode == 126


def test_signals_are_as_after_login(guard: str) -> None:
    def spoil() -> None:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})

    done = run(guard, str(os.getpid()), "--", "cat", "/proc/self/status", preexec_fn=spoil)
    status = dict(line.split(":\t", 1) for line in done.stdout.splitlines() if ":\t" in line)
    assert int(status["SigIgn"], 16) == 0
    assert int(status["SigBlk"], 16) == 0


def test_the_command_dies_with_its_parent(guard: str) -> None:
    # The middle process starts the command behind the guard, tells its pid, and is killed.
    script = (
        "import os, subprocess, sys, time\n"
        f"child = subprocess.Popen([{guard!r}, str(os.getpid()), '--', 'sleep', '3600'])\n"
        "print(child.pid, flush=True)\n"
        "time.sleep(3600)\n"
    )
    middle = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert middle.stdout is not None
    with middle.stdout:
        grandchild = os.pidfd_open(int(middle.stdout.readline()))
    try:
        middle.kill()
        middle.wait()
        assert select.select([grandchild], [], [], 20.0)[0], "the command lives on"
    finally:
        os.close(grandchild)
