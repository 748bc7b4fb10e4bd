"""Nodes that flood, are deaf and get away from their parent, on a terminal."""

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

from tests.process.test_guard import ESCAPES, escaping
from tests.support.replay import COMMAND, alive
from tests.support.waiting import until

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


def configuration(folder: Path) -> tuple[Path, list[Path]]:
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
        with contextlib.suppress(OSError):  # EIO: nobody has the terminal any more
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
    config, marks = configuration(tmp_path)
    logs = tmp_path / "logs"
    command = [str(COMMAND), "replay", str(config), "--log-dir", str(logs)]
    with Shown(command) as shown:
        until(lambda: all(mark.exists() for mark in marks), "all of them")
        everything = psutil.Process(shown.process.pid).children(recursive=True)
        # Of jobs of a shell, a session of its own, and a daemon.
        assert [each.name() for each in everything].count("sleep") >= 5
        shown.interrupt()
        code, said = shown.end()
        assert not alive(everything)
    assert code == 128 + signal.SIGINT
    dropped = re.search(r"([\d,]+) events dropped", said)
    lost = int(dropped[1].replace(",", "")) if dropped else 0
    numbers = recorded_lines((logs / "latest").resolve())
    assert numbers == sorted(set(numbers)), "in order, and each once"
    assert LINES <= len(numbers) + lost <= LINES + lost
