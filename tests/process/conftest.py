"""Fixtures of the tests with real processes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from blockbuster import blockbuster_ctx

from play_launch.container.ros import spawn_guard
from play_launch.process.guard import SessionGuard
from tests.process.programs import open_descriptors
from tests.support.waiting import until


@pytest.fixture(autouse=True)
def _loop_is_never_blocked() -> Iterator[None]:
    with blockbuster_ctx("play_launch") as blockbuster:
        # Popen waits for the exec of its vforked child.
        blockbuster.functions["os.read"].can_block_in("subprocess.py", "_execute_child")
        # What the guard of the session gets is a file in memory.
        write = blockbuster.functions["io.BufferedWriter.write"]
        write.can_block_in("process/guard.py", "_command_file")
        # The kernel lists the threads of a process from memory.
        blockbuster.functions["os.listdir"].can_block_in("process/time_slice.py", "_threads")
        yield


@pytest.fixture(autouse=True)
def _descriptors_do_not_leak() -> Iterator[None]:
    before = open_descriptors()
    yield
    # A thread of a cancelled test may be reading a file yet.
    until(lambda: open_descriptors() == before, f"{before}, not {open_descriptors()}", 10)


@pytest.fixture(autouse=True)
def _no_child_outlives_a_test() -> Iterator[None]:
    yield
    left = psutil.Process().children(recursive=True)
    for process in left:
        process.kill()
    psutil.wait_procs(left)
    assert not left


@pytest.fixture(scope="session")
def guard() -> Path:
    return spawn_guard()


@pytest.fixture
def session(guard: Path) -> Iterator[SessionGuard]:
    guarding = SessionGuard.start(guard)
    yield guarding
    guarding.close()
