"""Kills the supervisor alone, at random moments; what of its system lives on.

    python -m benchmarks.orphans [--trials N] [--seed N] [--json]

The trials take turns: the supervisor is killed in its `start`, while nodes are loaded (`load`),
in the midst of an `apply`, while a node crashes again and again (`crash`), while it `stop`s, and
at `rest`. The system has containers of every kind, and processes that are deaf to SIGINT, SIGTERM
and SIGHUP, that fork twice, and that do so without an environment. Everything happens in a network
and a /dev/shm of its own, so root is needed (or user namespaces), and iproute2.

An orphan is a process of the system that lives one second after the SIGKILL. What is left of Fast
DDS in /dev/shm is removed in the end by `python -m play_launch.ros.fastdds`, which is no part of
the system; the time until then is measured as well.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import signal
import subprocess
import tempfile
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Self

import psutil

from benchmarks.bring_up import COMMAND, ENVIRONMENT, TIMEOUT
from benchmarks.own_network import enter_namespace, is_inside
from benchmarks.progress import Progress
from benchmarks.statistics import header, row
from play_launch.ros.fastdds.shared_memory import SHARED_MEMORY, sweep, sweep_command

LIMIT = 1.0
"""Seconds from the death of the supervisor to that of everything else."""
LONGEST = 20.0
"""Seconds until the end of a trial, whatever is left."""
PHASES = {"start": 1.2, "load": 0.6, "apply": 1.0, "crash": 1.0, "stop": 0.6, "rest": 0.2}
"""Seconds in which the moment lies, from the beginning of each."""
MARK = "PLAY_LAUNCH_BENCHMARK_MARK"
KINDS = ("standard", "mt", "isolated", "isolated_mt", "process")
DEAF = "trap '' INT TERM HUP; while :; do sleep 600; done"
FORKS = "(setsid sleep 600 &); (env -i setsid sleep 600 &); exec sleep 600"


class Trial(NamedTuple):
    """Result of one trial."""

    phase: str
    moment: float
    """Seconds after the beginning of the phase."""
    processes: int
    """There were so many."""
    ended: float
    """Seconds until the last one was gone, as far as it was within the limit."""
    orphans: list[str]
    """Processes after the limit, and files after the longest time."""
    empty: float
    """Seconds until nothing of it was in /dev/shm any more."""
    files: list[str]
    """What was there at the limit, with the command of the owner of its lock before the kill."""
    load: float
    """Of the machine, for each processor."""


def configuration(*, text: str = "", more: bool = False) -> dict[str, Any]:
    """Make the system; ``text`` and ``more`` are what `apply` changes."""
    containers = [
        {
            "name": kind,
            "container_type": "isolated" if kind == "process" else kind,
            **({"isolation": "process"} if kind == "process" else {}),
            "composable_nodes": [_node("Talker", f"{kind}_{n}", text=text) for n in range(2)],
        }
        for kind in KINDS
    ]
    endless = {"max_restarts": 1_000_000, "backoff": {"initial": "50 ms", "maximum": "50 ms"}}
    crasher = {**_node("Crasher", "crasher", after=0.2), "restart": endless}
    containers.append(
        {"name": "crashing", "container_type": "isolated", "composable_nodes": [crasher]}
    )
    if more:
        containers.append(
            {"name": "more", "composable_nodes": [_node("Talker", "added", text=text)]}
        )
    commands = {"plain": "exec sleep 600", "deaf": DEAF, "forks": FORKS}
    nodes = [{"name": name, "command": ["sh", "-c", how]} for name, how in commands.items()]
    return {
        "version": 1,
        "stop": {"ask": "500 ms", "sigint": "500 ms", "sigterm": "500 ms"},
        "containers": containers,
        "nodes": nodes,
    }


def _node(plugin: str, name: str, **parameters: object) -> dict[str, Any]:
    return {
        "package": "play_launch_demo",
        "plugin": f"play_launch_demo::{plugin}",
        "name": name,
        "parameters": parameters,
    }


class Supervised:
    """A supervisor that is going to be killed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._mark = uuid.uuid4().hex
        for name, found in (("a", configuration()), ("b", configuration(text="b", more=True))):
            (folder / f"{name}.yaml").write_text(json.dumps(found), encoding="utf-8")
        command: list[str | Path] = [
            COMMAND,
            "replay",
            folder / "a.yaml",
            "--log-dir",
            folder / "logs",
            "--json",
        ]
        self._process = subprocess.Popen(
            [*command, "--quiet"],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**ENVIRONMENT, MARK: self._mark},
            text=True,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()

    def reach(self, phase: str) -> subprocess.Popen[bytes] | None:
        """Return at the beginning of a phase, with a command that is to be ended afterwards."""
        assert self._process.stdout is not None
        if phase == "start":
            return None
        loaded: set[str] = set()
        for line in self._process.stdout:
            event = json.loads(line)
            if phase == "load" and event["event"] == "container":
                return None
            if event["event"] == "node" and event["state"] == "loaded":
                loaded.add(event["node"])
            if len(loaded - {"/crasher"}) == 2 * len(KINDS):
                break
        else:
            raise SystemExit(f"the run ended with no more than {sorted(loaded)} loaded")
        if phase == "apply":
            session = (self._folder / "logs" / "latest").resolve()
            return subprocess.Popen(
                [COMMAND, "apply", self._folder / "b.yaml", "--session", session],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=ENVIRONMENT,
            )
        if phase == "stop":
            self._process.send_signal(signal.SIGINT)
        return None

    def there(self) -> list[psutil.Process]:
        """Give everything that it has started and that lives."""
        with contextlib.suppress(psutil.NoSuchProcess):
            return psutil.Process(self._process.pid).children(recursive=True)
        return []

    def kill(self, there: list[psutil.Process]) -> tuple[list[psutil.Process], float]:
        """Kill it alone.

        Returns what lives after the limit, and the seconds until the last one was gone.
        """
        assert self._process.stdout is not None
        self._process.kill()
        began = time.monotonic()
        self._process.wait()
        ended = 0.0
        left = there
        while time.monotonic() - began < LIMIT:
            if left:
                left = [each for each in left if _lives(each)]
                ended = time.monotonic() - began
            time.sleep(0.01)
        found = {each.pid: each for each in [*left, *self._marked()] if _lives(each)}
        self._process.stdout.close()
        return list(found.values()), ended

    def _marked(self) -> Iterator[psutil.Process]:
        """Give those that inherited the mark, also those that were started at the last moment."""
        needle = f"{MARK}={self._mark}".encode()
        for process in psutil.process_iter():
            with contextlib.suppress(OSError, psutil.NoSuchProcess):
                if process.cmdline()[1:] == sweep_command()[1:]:
                    continue
                if needle in Path(f"/proc/{process.pid}/environ").read_bytes().split(b"\0"):
                    yield process


def _lives(process: psutil.Process) -> bool:
    try:
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


def owners_of_segments(processes: list[psutil.Process]) -> dict[str, str]:
    """Give the command of each that holds the lock of a segment or port of Fast DDS."""
    found = {}
    for process in processes:
        with contextlib.suppress(OSError, psutil.NoSuchProcess):
            command = " ".join(process.cmdline())
            for link in Path(f"/proc/{process.pid}/fd").iterdir():
                name = Path(os.readlink(link)).name  # noqa: PTH115 - not to be followed
                if name.startswith(("fastrtps_", "fastdds_")):
                    found[name.removesuffix("_el")] = command
    return found


def files_of_fastdds() -> list[Path]:
    return sorted(SHARED_MEMORY.glob("*fast[rd]*_*"))


def run_once(folder: Path, phase: str, moment: float) -> Trial:
    """Kill one supervisor, and what it left as well."""
    load = os.getloadavg()[0] / len(os.sched_getaffinity(0))
    with Supervised(folder) as supervised:
        command = supervised.reach(phase)
        time.sleep(moment)
        there = supervised.there()
        owners = owners_of_segments(there)
        orphans, ended = supervised.kill(there)
    files = [
        f"{path.name} ({owners.get(path.name.removesuffix('_el'), '?')})"
        for path in files_of_fastdds()
    ]
    empty = LIMIT
    while files_of_fastdds() and empty < LONGEST:
        time.sleep(0.1)
        empty += 0.1
    described = []
    for each in orphans:
        with contextlib.suppress(psutil.NoSuchProcess):
            described.append(f"{each.pid} {' '.join(each.cmdline())} ({each.status()})")
            each.kill()
    if command is not None:
        command.wait(TIMEOUT)
    psutil.wait_procs(orphans, timeout=TIMEOUT)
    described += [f"{name} after {LONGEST:g} s" for name in sweep().removed]
    return Trial(phase, moment, len(there), ended, described, empty, files, load)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if not is_inside():
        enter_namespace("benchmarks.orphans")
    moments = random.Random(options.seed)
    progress = Progress()
    trials: list[Trial] = []
    phases = list(PHASES)
    for number in range(options.trials):
        phase = phases[number % len(phases)]
        with tempfile.TemporaryDirectory(prefix="orphans-") as folder:
            trials.append(run_once(Path(folder), phase, moments.uniform(0, PHASES[phase])))
        found = trials[-1]
        progress.tell(f"{number + 1} of {options.trials}", force=bool(found.orphans))
        for what in found.orphans:
            progress.tell(f"  {phase}, {found.moment:.3f} s: left {what}", force=True)
    if options.json:
        print(json.dumps([trial._asdict() for trial in trials]))
        return
    print(f"{len(trials)} kills of the supervisor alone")
    for phase in phases:
        of_phase = [trial for trial in trials if trial.phase == phase]
        if not of_phase:
            continue
        orphans = sum(len(trial.orphans) for trial in of_phase)
        print(f"\n{phase}: {len(of_phase)} kills, {orphans} orphans")
        print(header())
        print(row("processes", [trial.processes for trial in of_phase], ""))
        print(row("until the last one was gone", [trial.ended for trial in of_phase], "s"))
        print(row("until /dev/shm was empty", [trial.empty for trial in of_phase], "s"))
        print(row("load, for each processor", [trial.load for trial in of_phase], ""))


if __name__ == "__main__":
    main()
