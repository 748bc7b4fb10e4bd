from __future__ import annotations

import asyncio
import inspect
from typing import TYPE_CHECKING

import pytest
from blockbuster import blockbuster_ctx

from play_launch.process.processor_wait import ProcessorWait
from play_launch.runtime import watchdog

from . import jumping_loop

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that is a coroutine function; its loop jumps over every wait, or uses real time.

    It is real in modules with ``REAL_TIME``.
    """
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    names = inspect.signature(pyfuncitem.obj).parameters
    run = asyncio.run if hasattr(pyfuncitem.module, "REAL_TIME") else jumping_loop.run
    run(pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in names}))
    return True


@pytest.fixture(autouse=True)
def _loop_is_never_blocked() -> Iterator[None]:
    with blockbuster_ctx("play_launch") as blockbuster:
        # Popen waits for the exec of its vforked child.
        blockbuster.functions["os.read"].can_block_in("subprocess.py", "_execute_child")
        # What the guard of the session gets is a file in memory.
        write = blockbuster.functions["io.BufferedWriter.write"]
        write.can_block_in("process/guard.py", "_command_file")
        # The kernel lists the threads of a process from memory.
        listdir = blockbuster.functions["os.listdir"]
        listdir.can_block_in("process/processor_wait.py", "thread_wait")
        listdir.can_block_in("process/processor_wait.py", "processor_wait")
        listdir.can_block_in("process/time_slice.py", "_threads")
        yield


@pytest.fixture(autouse=True)
def _processors_abound(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time jumps here: what the kernel counts meanwhile means nothing."""
    none = ProcessorWait(0.0, wants_one=False)
    monkeypatch.setattr(watchdog, "waits", lambda pid: (none, none))
