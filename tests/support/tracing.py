"""A tracer, as a debugger is one: its threads stop, and their ends wait for it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

TRACER = """
import ctypes, os, sys
libc = ctypes.CDLL(None, use_errno=True)
SEIZE, INTERRUPT, ALL = 0x4206, 0x4207, 0x40000000
threads = [int(each) for each in os.listdir(f"/proc/{sys.argv[1]}/task")]
for thread in threads:
    for request in (SEIZE, INTERRUPT):
        if libc.ptrace(request, thread, None, None):
            sys.exit(os.strerror(ctypes.get_errno()))
for thread in threads:
    os.waitpid(thread, ALL)
print("stopped", flush=True)
sys.stdin.read()
"""


@contextmanager
def stopped_by_a_tracer(pid: int) -> Iterator[int]:
    """Have all threads of a process stopped by another, whose pid this gives, until the end."""
    command = [sys.executable, "-I", "-S", "-c", TRACER, str(pid)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as tracer:
        assert tracer.stdout is not None
        assert tracer.stdout.readline() == "stopped\n"
        yield tracer.pid
        tracer.kill()  # the kernel lets all of them go on
