"""A system that is up while something is measured, and its last event."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.bring_up import COMMAND, ENVIRONMENT, TIMEOUT


@dataclass
class Running:
    """The supervisor; `last` is the event read last, after the end of the run its summary."""

    pid: int
    last: dict[str, Any] = field(default_factory=dict)


@contextlib.contextmanager
def running(config: Path, logs: Path, nodes: int, *, limit: float = TIMEOUT) -> Iterator[Running]:
    """Run a system while the block runs, which begins when that many nodes are loaded.

    Raises SystemExit when they are not within ``limit`` seconds, or the run ends before.
    """
    with subprocess.Popen(
        [COMMAND, "replay", config, "--log-dir", logs, "--json", "--quiet"],
        stdout=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
    ) as process:
        run = Running(process.pid)
        try:
            loaded = _load(process, run, nodes, limit)
            if loaded != nodes:
                raise SystemExit(f"only {loaded} of {nodes} nodes were loaded")
            yield run
        finally:
            _stop(process, run)


def _load(process: subprocess.Popen[str], run: Running, nodes: int, limit: float) -> int:
    """Read events until so many nodes are loaded or the run ends; return how many are."""
    assert process.stdout is not None
    # Nothing may be said any more, so the end of the time ends what would be waited for.
    alarm = threading.Timer(limit, process.send_signal, [signal.SIGINT])
    alarm.start()
    loaded = 0
    try:
        while loaded < nodes and (line := process.stdout.readline()):
            run.last = json.loads(line)
            loaded += run.last["event"] == "component" and run.last["kind"] == "loaded"
    finally:
        alarm.cancel()
    return loaded


def _stop(process: subprocess.Popen[str], run: Running) -> None:
    process.send_signal(signal.SIGINT)
    try:
        rest, _ = process.communicate(timeout=TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    if rest:
        run.last = json.loads(rest.splitlines()[-1])
