"""The real daemon among clients that misbehave: it stays up, small and quick for the others."""

from __future__ import annotations

import contextlib
import json
import os
import random
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from play_launch.graph_daemon.contract import STATUS_METHOD, DaemonAddress
from play_launch.graph_daemon.http_head import LONGEST_BODY as LARGEST_BODY
from tests.graph_daemon.wire import ask, post, read, request_body

MEMORY = 150 * 1024 * 1024
"""Bytes by which abuse may let the daemon grow: its own limit of 64 MiB, and room to breathe."""


def memory(pid: int) -> int:
    """Resident memory in bytes."""
    pages = int((Path("/proc") / str(pid) / "statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


@pytest.fixture
def abused(daemon: DaemonAddress, capsys: pytest.CaptureFixture[str]) -> Iterator[DaemonAddress]:
    """The daemon; afterwards it is the same one, has not grown, and answers."""
    pid = int(json.loads(ask(daemon, STATUS_METHOD))["pid"])
    before = memory(pid)
    yield daemon
    took = []
    for _ in range(20):
        began = time.monotonic()
        assert ask(daemon, "get_namespace") == "/"
        took.append(time.monotonic() - began)
    grown = memory(pid) - before
    with capsys.disabled():
        print(f"\nlongest of 20 answers {max(took) * 1e3:.1f} ms, grown by {grown >> 20} MiB")
    assert json.loads(ask(daemon, STATUS_METHOD))["pid"] == pid
    assert grown < MEMORY


def connect(address: DaemonAddress) -> socket.socket:
    return socket.create_connection((address.host, address.port), timeout=60)


def call(method: str) -> bytes:
    body = request_body(method, [])
    return b"POST /ros2cli/ HTTP/1.1\r\nContent-Length: %d\r\n\r\n%b" % (len(body), body)


def test_clients_that_never_read(abused: DaemonAddress) -> None:
    greedy = [connect(abused) for _ in range(50)]
    many = call("get_topic_names_and_types") * 200
    for client in greedy:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        client.setblocking(False)
        with contextlib.suppress(OSError):
            while client.send(many):
                pass
    assert ask(abused, "get_namespace") == "/"
    for client in greedy:
        client.close()


def test_huge_requests(abused: DaemonAddress) -> None:
    head = b"POST /ros2cli/ HTTP/1.1\r\nContent-Length: 4000000000\r\n\r\n"
    with connect(abused) as client:
        client.sendall(head)
        assert client.recv(100).startswith(b"HTTP/1.1 413 ")
        # What follows is read and dropped, or the connection is reset.
        with contextlib.suppress(OSError):
            for _ in range(200):
                client.sendall(b"x" * 100_000)
    with connect(abused) as client, contextlib.suppress(OSError):
        for _ in range(200):
            client.sendall(b"y" * 100_000)


def test_requests_of_many_kinds_fill_no_memory(abused: DaemonAddress) -> None:
    """Each has an answer of its own, so that keeping all of them would be too much."""
    for number in range(500):
        name = f"{number:06d}" * (LARGEST_BODY // 8)
        status, body = post(abused, request_body("count_publishers", [f"/{name}"]))
        assert status == 200
        assert read(body)[0] == "fault"


def test_noise(abused: DaemonAddress) -> None:
    noise = random.Random(7)
    beginnings = (b"", b"POST ", b"POST /ros2cli/ HTTP/1.1\r\n", call("get_name")[:60])
    for _ in range(300):
        with connect(abused) as client, contextlib.suppress(OSError):
            client.sendall(noise.choice(beginnings) + noise.randbytes(noise.randrange(2_000)))
            client.shutdown(socket.SHUT_WR)
            client.recv(1_000)
