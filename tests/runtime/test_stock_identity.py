"""The CPU time of a container that was not made by us."""

from __future__ import annotations

import subprocess
import sys
import time

from play_launch.runtime.stock.loads import cpu_time_ns

# Uses CPU time until it has what is asked for, then says so and waits.
BUSY = """
import sys, time
while time.process_time() < 0.2:
    pass
print(flush=True)
sys.stdin.read()
"""


def test_the_cpu_time_of_another_process_is_known() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", BUSY], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"\n"
        used = cpu_time_ns(process.pid)
        # The kernel reports it in ticks of 10 ms.
        assert 150_000_000 <= used < time.monotonic_ns()
        assert process.stdin is not None
        process.stdin.close()
    assert cpu_time_ns(process.pid) == 0


def test_a_container_of_something_else_has_none() -> None:
    assert cpu_time_ns(0) == 0
