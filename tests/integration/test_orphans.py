"""A session leaves nothing behind, whatever its nodes did, and loses no line uncounted."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import pty
import re
import signal
import subprocess
import sys
import termios
import threading
from pathlib import Path
from typing import Any, Self

import psutil
from rosbags.highlevel import AnyReader

from play_launch.ros.fastdds.shared_memory import SHARED_MEMORY, sweep
from tests.process.test_guard import ESCAPES, escaping
from tests.support.replay import COMMAND, Replay, alive, named, replaying
from tests.support.scenes import container, node, written
from tests.support.waiting import until

ESCAPED = 7
"""Processes that `ESCAPES` let loose."""
LIMIT = 1.0
"""Seconds from the death of the supervisor to that of everything else."""


def configuration() -> dict[str, Any]:
    kinds = ("standard", "isolated")
    return {
        "version": 1,
        # It has a guard of its own, and a test of its own in tests/recording/topic_recorder.
        "record": {"ros": False},
        "containers": [
            container(kind, node(f"talker_{kind}"), container_type=kind) for kind in kinds
        ],
        "nodes": [{"name": how.replace(" ", "_"), "command": escaping(how)} for how in ESCAPES],
    }


def started(replay: Replay, *more: str) -> list[psutil.Process]:
    """Wait until everything runs and has let loose what gets away; give all of it."""
    waiting = {f"/{how.replace(' ', '_')}" for how in ESCAPES} | {"/talker_standard"}
    waiting |= {"/talker_isolated", *more}
    pids: set[int] = set()

    def is_last(event: dict[str, Any]) -> bool:
        if event["event"] == "output" and event["process"] in waiting:
            if event["text"] == "ready":
                waiting.discard(event["process"])
            elif event["text"].isdecimal():
                pids.add(int(event["text"]))
        if event["event"] == "node" and event["state"] == "loaded":
            waiting.discard(event["node"])
            pids.add(event["pid"])
        return not waiting

    replay.read_until(is_last, "everything running")
    found = {each.pid: each for each in replay.descendants()}
    assert set(pids) <= set(found), "whatever gets away stays below the guard"
    return list(found.values())


def ports_of(domain: int) -> list[str]:
    """Names of the ports of a domain that are in shared memory; those of its processes."""
    first = 7400 + 250 * domain
    numbers = {f"fastrtps_port{number}" for number in range(first, first + 250)}
    return [path.name for path in SHARED_MEMORY.iterdir() if path.name in numbers]


def test_nothing_outlives_a_supervisor_that_is_killed_alone(
    tmp_path: Path, ros_domain: int
) -> None:
    config = written(tmp_path, **configuration())
    with replaying(config, tmp_path / "logs") as replay:
        left = started(replay)
        assert len(left) > len(ESCAPES) + 2
        os.kill(replay.pid, signal.SIGKILL)
        replay.process.wait()
        psutil.wait_procs(left, timeout=LIMIT)
        left = alive(left)
        for each in left:
            each.kill()
    assert not left
    # Sending to a port that was removed makes it anew, so they are left by those that end well.
    until(lambda: not ports_of(ros_domain), "an empty shared memory")


def test_containers_and_their_nodes_do_not_outlive_supervisor_and_guard_killed_together(
    tmp_path: Path,
) -> None:
    """The documented limit: what got away from its parent stays, and nothing else."""
    values = configuration()
    containers = values["containers"]
    containers += [
        {**each, "name": f"{each['name']}_mt", "container_type": kind, "composable_nodes": []}
        for each, kind in zip(containers, ("mt", "isolated_mt"), strict=True)
    ]
    containers.append({**containers[1], "name": "processes", "isolation": "process"})
    containers[-1]["composable_nodes"] = [node("talker_process")]
    values["nodes"].append({"name": "plain", "command": ["sleep", "600"]})
    config = written(tmp_path, **values)
    with replaying(config, tmp_path / "logs") as replay:
        everything = started(replay, "/talker_process")
        (guard,) = psutil.Process(replay.pid).children()
        direct = guard.children()
        containers = [each for each in direct if "component_container" in each.cmdline()[0]]
        assert len(containers) == len(values["containers"])
        nodes = [one for each in containers for one in each.children(recursive=True)]
        assert len(nodes) >= 2
        os.kill(replay.pid, signal.SIGKILL)
        os.kill(guard.pid, signal.SIGKILL)
        replay.process.wait()
        psutil.wait_procs([*direct, *nodes], timeout=LIMIT)
        left = alive(everything)
        for each in left:
            each.kill()
    sweep()  # killed containers leave shared memory, which the next run removes
    gone = [guard, *containers, *nodes]
    assert not [each for each in left if each in gone]
    assert len(left) <= ESCAPED, "one without a session, jobs, sessions, a fork, a daemon"


RATE, SECONDS = 50_000, 2
LINES = RATE * SECONDS
FLOOD = f"""
import os, pathlib, sys, time
said, begin = 0, time.monotonic()
while said < {LINES}:
    due = min(int((time.monotonic() - begin) * {RATE}), {LINES})
    rest = b"".join(b"line %d\\n" % number for number in range(said, due))
    while rest:
        rest = rest[os.write(1, rest):]
    said = due
    time.sleep(0.002)
pathlib.Path(sys.argv[1]).touch()
"""
DEAF = """
import pathlib, signal, sys, time
for number in set(signal.Signals) - {signal.SIGKILL, signal.SIGSTOP}:
    signal.signal(number, signal.SIG_IGN)
pathlib.Path(sys.argv[1]).touch()
time.sleep(600)
"""
# The child of a child that has ended, in a session of its own, as deaf as its grandparent.
GRANDPARENT = f"""
import os
if os.fork() == 0:
    os.setsid()
    os.fork() and os._exit(0)
{DEAF}
"""
PROGRAMS = {"flood": FLOOD, "deaf": DEAF, "grandparent": GRANDPARENT}


def hostile(folder: Path) -> tuple[Path, list[Path]]:
    """Write one; return it, and the files that say when all of them are as bad as they can be."""
    python = [sys.executable, "-I", "-S", "-c"]
    marks = [folder / f"{name}.ready" for name in PROGRAMS]
    nodes = [
        {"name": name, "command": [*python, code, str(mark)]}
        for (name, code), mark in zip(PROGRAMS.items(), marks, strict=True)
    ]
    nodes += [{"name": how.replace(" ", "_"), "command": escaping(how)} for how in ESCAPES]
    talker = {"package": "play_launch_demo", "plugin": "play_launch_demo::Talker"}
    values = {
        "version": 1,
        "stop": {"ask": "200 ms", "sigint": "200 ms", "sigterm": "200 ms"},
        "containers": [{"name": "box", "composable_nodes": [{**talker, "name": "talker"}]}],
        "nodes": nodes,
    }
    config = folder / "hostile.yaml"
    config.write_text(json.dumps(values), encoding="utf-8")
    return config, marks


class Shown:
    """A command, and what it shows on a terminal of its own."""

    def __init__(self, command: list[str]) -> None:
        self._ours, theirs = pty.openpty()
        self._interrupt = termios.tcgetattr(theirs)[6][termios.VINTR]
        self.process = subprocess.Popen(
            command,
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509
        )
        os.close(theirs)
        self._said = bytearray()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        self._reader.join(60)
        os.close(self._ours)

    def interrupt(self) -> None:
        """Ask it to end as a person does, so that the terminal makes a signal."""
        os.write(self._ours, self._interrupt)

    def end(self) -> tuple[int, str]:
        """Wait for its end; give exit code and output."""
        code = self.process.wait(60)
        self._reader.join(60)
        return code, self._said.decode(errors="replace")

    def _read(self) -> None:
        with contextlib.suppress(OSError):  # EIO: the terminal is closed
            while data := os.read(self._ours, 65536):
                self._said += data


def recorded_lines(folder: Path) -> list[int]:
    """Give the numbers of the flood, as they were recorded."""
    found = []
    with AnyReader([folder]) as reader:
        output = [each for each in reader.connections if each.topic == "/play_launch/output"]
        for connection, _, raw in reader.messages(output):
            message: Any = reader.deserialize(raw, connection.msgtype)
            if message.name.strip("/") == "flood":
                found.append(int(message.msg.removeprefix("line ")))
    return found


def test_none_gets_away_and_no_line_is_lost_uncounted(tmp_path: Path) -> None:
    config, marks = hostile(tmp_path)
    logs = tmp_path / "logs"
    command = [str(COMMAND), "replay", str(config), "--log-dir", str(logs)]
    with Shown(command) as shown:
        until(lambda: all(mark.exists() for mark in marks), "all of them")
        everything = psutil.Process(shown.process.pid).children(recursive=True)
        # Of jobs of a shell, a session of its own, and a daemon.
        assert len(named(everything, "sleep")) >= 5
        shown.interrupt()
        code, said = shown.end()
        assert not alive(everything)
    assert code == 128 + signal.SIGINT
    dropped = re.search(r"([\d,]+) events dropped", said)
    lost = int(dropped[1].replace(",", "")) if dropped else 0
    numbers = recorded_lines((logs / "latest").resolve())
    assert numbers == sorted(set(numbers)), "in order, and each once"
    assert LINES <= len(numbers) + lost <= LINES + lost
