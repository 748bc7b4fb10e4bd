"""The real command, and what it left behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
from rosbags.highlevel import AnyReader

from tests.support.loopback_network import wrapped
from tests.support.shared_memory import segments_of
from tests.support.waiting import until

_OWN_FAULTS = {-signal.SIGABRT, -signal.SIGSEGV, -signal.SIGBUS}
COMMAND = Path(sys.executable).parent / "play-launch"


def finished(
    command: Sequence[object], *, code: int | None = None, **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run a program to its end; with ``code``, it has to exit with that."""
    try:
        done = subprocess.run(
            [*map(str, command)],
            check=False,
            **{"capture_output": True, "text": True, "timeout": 120, **options},
        )
    except subprocess.TimeoutExpired as hung:
        hung.add_note(f"It printed: {hung.stdout!r} {hung.stderr!r}")
        raise
    assert code in {None, done.returncode}, f"{done.returncode}: {done.stdout}{done.stderr}"
    return done


def run(
    *words: object, code: int | None = None, **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run the command to its end; with ``code``, it has to exit with that."""
    return finished([COMMAND, *words], code=code, **options)


def recorded(bag: Path, topic: str) -> list[Any]:
    """The messages of a topic in a recording, read by code that is not ours."""
    with AnyReader([bag]) as reader:
        connections = [each for each in reader.connections if each.topic == topic]
        # Without connections, it would be all topics.
        return [
            reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in (reader.messages(connections) if connections else ())
        ]


def is_(**wanted: object) -> Callable[[dict[str, Any]], bool]:
    """Whether an event has these values."""
    return lambda event: all(event.get(key) == value for key, value in wanted.items())


@dataclass
class Replay:
    """A running ``play-launch replay --json``."""

    process: subprocess.Popen[str]
    log_dir: Path
    seen: list[dict[str, Any]]

    @property
    def pid(self) -> int:
        return self.process.pid

    @property
    def bag(self) -> Path:
        """The recording of the only session."""
        return self.log_dir / "latest" / "session.mcap"

    def read_until(self, wanted: Any, what: str) -> dict[str, Any]:
        """Read events until one for which ``wanted(event)`` holds, and return it."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            event: dict[str, Any] = json.loads(line)
            self.seen.append(event)
            if wanted(event):
                return event
        raise AssertionError(f"the run ended without {what}; it told {self.seen[-5:]}")

    def until(self, **wanted: object) -> dict[str, Any]:
        """Read events until one with these values, and return it."""
        return self.read_until(is_(**wanted), f"{wanted}")

    def told(self, **wanted: object) -> list[dict[str, Any]]:
        """The events that were read and have these values."""
        return [event for event in self.seen if is_(**wanted)(event)]

    def read_until_up(self, *names: str) -> dict[str, dict[str, Any]]:
        """Read events until each node is loaded, and each member started; those events by name."""
        found: dict[str, dict[str, Any]] = {}

        def is_last(event: dict[str, Any]) -> bool:
            if is_(event="node", state="loaded")(event):
                found[event["node"]] = event
            if is_(event="process", kind="started")(event):
                found[event["name"]] = event
            return found.keys() >= set(names)

        self.read_until(is_last, f"{names} to be up")
        return found

    def ask(self, *words: object, code: int | None = None) -> subprocess.CompletedProcess[str]:
        """Run a command about this session."""
        return run(*words, "--session", (self.log_dir / "latest").resolve(), code=code)

    def until_operable(self) -> None:
        """Wait until the session answers, a moment after its start."""
        until(lambda: self.ask("ps").returncode == 0, "a session that answers")

    def pids(self) -> dict[str, int]:
        """The process ids of all members and nodes by name, as ``ps`` says."""
        return {row["name"]: row["pid"] for row in json.loads(self.ask("ps", "--json").stdout)}

    def read_until_states(self, wanted: dict[str, str]) -> None:
        """Read events until each node, by its full name, is in its wanted state at last."""
        states: dict[str, str] = {}

        def reached(event: dict[str, Any]) -> bool:
            if event["event"] == "node":
                states[event["node"]] = event["state"]
            return all(states.get(node) == state for node, state in wanted.items())

        self.read_until(reached, f"the states {wanted}")

    def read_all(self) -> list[dict[str, Any]]:
        """Read to the end and wait for it."""
        assert self.process.stdout is not None
        self.seen += [json.loads(line) for line in self.process.stdout]
        self.process.wait(timeout=60)
        return self.seen

    def descendants(self) -> list[psutil.Process]:
        """Everything that the supervisor started and that still runs."""
        try:
            return psutil.Process(self.pid).children(recursive=True)
        except psutil.NoSuchProcess:
            return []


def named(processes: Iterable[psutil.Process], name: str) -> list[psutil.Process]:
    """Those whose name begins so, without what has ended since they were listed."""

    def begins(process: psutil.Process) -> bool:
        try:
            return process.name().startswith(name)
        except psutil.NoSuchProcess:
            return False

    return [each for each in processes if begins(each)]


@contextmanager
def replaying(
    config: Path,
    log_dir: Path,
    *arguments: str,
    in_a_network: bool = False,
    program: Sequence[str] = (str(COMMAND),),
) -> Iterator[Replay]:
    """Run ``play-launch replay``; afterwards it is gone, and so is everything it started.

    With ``in_a_network`` it has a network of its own, with nothing but a loopback. ``program`` may
    be another way to run the command. An orderly exit leaves no segment of Fast DDS.
    """
    command = [*program, "replay", str(config), "--log-dir", str(log_dir), "--json", *arguments]
    process = subprocess.Popen(
        wrapped(*command) if in_a_network else command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    replay = Replay(process, log_dir, [])
    held: set[Path] = set()
    try:
        yield replay
    finally:
        if process.poll() is None:
            held = segments_of([replay.pid, *(each.pid for each in replay.descendants())])
            process.send_signal(signal.SIGINT)
        try:
            _, errors = process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            for child in replay.descendants():
                child.kill()
            process.kill()
            process.communicate()
            raise
    assert process.returncode not in _OWN_FAULTS, f"it died: {errors[-4000:]}"
    left = {path.name for path in held if path.exists()}
    assert not left, f"segments of Fast DDS are left: {left}"


def alive(processes: list[psutil.Process]) -> list[psutil.Process]:
    """Those that still run; identity is pid and start time, so a reused pid does not count."""
    return [each for each in processes if _is_alive(each)]


def _is_alive(process: psutil.Process) -> bool:
    try:
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False
