"""Slow connections to machines, and slow readers of what is printed."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from play_launch.deploy.machines.namespaces import missing
from tests.support.hosts import Hosts, running, supervisors, system
from tests.support.waiting import until

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"hosts: {missing()}")


SLOW = """\
import socket, sys, threading, time
from os import read, write

def carry(take, give):
    while data := take():
        give(data)
        time.sleep(len(data) / 400_000)

server = socket.create_connection((sys.argv[1], 22))
server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
threading.Thread(target=carry, args=(lambda: read(0, 4096), server.sendall), daemon=True).start()
carry(lambda: server.recv(4096), lambda data: write(1, data))
"""
"""Carries an ssh connection, 400 kB/s each way."""


def test_lines_that_flood_a_slow_connection_hold_up_nothing(net: Hosts, tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    ssh = net.home / ".ssh/config"
    before = ssh.read_text()
    proxy = f"{sys.executable} {tmp_path}/slow.py %h"
    ssh.write_text(f"Host h3 10.77.0.3\n  ProxyCommand {proxy}\n{before}")
    path = system(tmp_path, "flooded")
    text = "line=$(printf %0150d 0); i=0; while :; do echo $((i += 1)) $line; done"
    with path.open("a") as file:
        file.write(f"  - {{name: flood, machine: h3, command: [bash, -c, '{text}']}}\n")
    try:
        with running(net, path) as flooded:
            flooded.loaded()
            until(lambda: "came faster than the connection carries" in flooded.printed(), "a flood")
            for _ in range(5):
                assert flooded.rows()["/flood"]["state"] == "running"
            seen = flooded.printed().count('"tick ')
            until(lambda: flooded.printed().count('"tick ') > seen + 10, "lines of another one")
            flooded.stop()
        ticks = flooded.ticks()
        assert ticks == list(range(1, ticks[-1] + 1))
    finally:
        ssh.write_text(before)


def test_a_terminal_that_takes_nothing_holds_up_no_machine(net: Hosts, tmp_path: Path) -> None:
    config = system(tmp_path, "unread")
    config.write_text(config.read_text().replace("echo tick $((i += 1))", "seq 1 5000"))
    command = net.play_launch("replay", str(config))
    reading, writing = os.pipe()
    with subprocess.Popen(
        command, env=net.environment, stdin=subprocess.DEVNULL, stdout=writing
    ) as unread:
        try:
            session = ("--session", str(unread.pid))
            until(lambda: not select.select([], [writing], [], 0)[1], "a pipe that is full")
            net.run("wait", "--timeout", "40s", *session, code=0)
            net.run("restart", "listen", *session, code=0)
            unread.send_signal(signal.SIGINT)
            assert unread.wait(40) == 130
        finally:
            os.close(reading)
            os.close(writing)
    assert not supervisors(net, 3)


def test_a_machine_that_answers_again_during_the_stop_is_stopped(
    net: Hosts, tmp_path: Path
) -> None:
    config = system(tmp_path, "returns", more="stop: {sigint: 4 s, sigterm: 1 s}")
    slow = """[bash, -c, "trap '' INT; sleep 1000"]"""
    config.write_text(config.read_text().replace('[sleep, "1000"]', slow))
    with running(net, config) as returns:
        returns.loaded()
        net.set_link(3, "down")
        try:
            until(lambda: returns.rows()["/listener"]["state"] == "unreachable", "the loss")
            returns.process.send_signal(signal.SIGINT)
            until(lambda: "SIGINT: shutting down" in returns.printed(), "the stop")
        finally:
            net.set_link(3, "up")
        assert returns.process.wait(40) == 3  # it was missing when the stop began
        assert not supervisors(net, 3)
