"""Every test here runs on an event loop, which nothing blocks."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from blockbuster import blockbuster_ctx


@pytest.fixture(autouse=True)
def _loop_is_never_blocked() -> Iterator[None]:
    with blockbuster_ctx("play_launch") as blockbuster:
        # Popen waits for the exec of its vforked child. What the guard of the session gets is a
        # file in memory.
        functions = blockbuster.functions
        functions["os.read"].can_block_in("subprocess.py", "_execute_child")
        functions["io.BufferedWriter.write"].can_block_in("process/guard.py", "_command_file")
        yield
