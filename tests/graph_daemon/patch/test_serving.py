"""A patched daemon as its clients see it; the daemon is made up, the changes are the real ones."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import time
import xmlrpc.client
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

import pytest

from tests.graph_daemon.patch.conftest import LIMIT, Ros

START = "from ros2cli.daemon import main; main()"
TIME_WAIT = "06"


class Daemon:
    """A running stand-in."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.port = int(self._line().removeprefix("port "))

    def proxy(self) -> Any:
        return xmlrpc.client.ServerProxy(f"http://127.0.0.1:{self.port}/ros2cli/", allow_none=True)

    def call(self, method: str, *arguments: Any) -> Any:
        with self.proxy() as proxy:
            return getattr(proxy, method)(*arguments)

    def connect(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=LIMIT)

    def end(self) -> list[str]:
        """Wait for its end; returns what it has printed since it was up."""
        out, _ = self.process.communicate(timeout=LIMIT)
        assert self.process.returncode == 0
        return out.splitlines()

    def _line(self) -> str:
        stream: IO[str] | None = self.process.stdout
        assert stream is not None
        return stream.readline().rstrip()


Start = Callable[..., Daemon]


@pytest.fixture
def start(patched_ros: Ros) -> Iterator[Start]:
    daemons: list[Daemon] = []

    def run(**environment: str) -> Daemon:
        process = subprocess.Popen(
            [str(patched_ros.python), "-c", START],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=environment,
        )
        daemons.append(Daemon(process))
        return daemons[-1]

    yield run
    for daemon in daemons:
        daemon.process.kill()
        daemon.process.wait(LIMIT)
        assert daemon.process.stdout is not None
        daemon.process.stdout.close()


@pytest.fixture
def daemon(start: Start) -> Daemon:
    return start()


def request(method: str, arguments: tuple[Any, ...] = ()) -> bytes:
    body = xmlrpc.client.dumps(arguments, method).encode()
    return f"POST /ros2cli/ HTTP/1.1\r\nContent-Length: {len(body)}\r\n\r\n".encode() + body


def read_answer(connection: socket.socket) -> Any:
    """Read as much as the head announces, and no more."""
    received = bytearray()
    while True:
        received += connection.recv(1 << 20)
        length = re.search(rb"(?i)content-length: (\d+)", received)
        head = received.find(b"\r\n\r\n")
        if head >= 0 and length and len(received) >= head + 4 + int(length[1]):
            return xmlrpc.client.loads(bytes(received[head + 4 :]))[0][0]


@pytest.mark.parametrize(
    "header",
    [
        "Origin: http://example.org",
        "origin: null",
        "Host: example.org",
        "HOST:example.org:11511",
        "Host: 127.0.0.1.example.org",
        "Host: 127.0.0.1\r\nHost: example.org",
    ],
)
def test_a_page_of_the_web_cannot_shut_it_down(daemon: Daemon, header: str) -> None:
    asked = request("system.shutdown").replace(b"\r\n", f"\r\n{header}\r\n".encode(), 1)
    with daemon.connect() as connection:
        connection.sendall(asked)
        assert connection.recv(1 << 20).startswith(b"HTTP/1.0 403 Forbidden\r\n")
    assert daemon.call("get_count") == 1
    assert daemon.process.poll() is None


def test_answers_about_the_graph_are_given_again_for_a_while(daemon: Daemon) -> None:
    asked = [daemon.call("get_count") for _ in range(200)]
    assert asked[0] == 1
    assert asked == sorted(asked)
    assert asked[-1] < len(asked)
    # Not without end.
    deadline = time.monotonic() + LIMIT
    while daemon.call("get_count") == asked[-1]:
        assert time.monotonic() < deadline


def test_what_is_asked_of_the_daemon_itself_is_always_done(daemon: Daemon) -> None:
    assert [daemon.call("system.count") for _ in range(20)] == list(range(1, 21))


def test_failures_are_not_kept(daemon: Daemon) -> None:
    texts = []
    for _ in range(5):
        with pytest.raises(xmlrpc.client.Fault) as fault:
            daemon.call("get_error")
        texts.append(fault.value.faultString)
    assert len(set(texts)) == 5


def test_many_different_questions_are_answered(daemon: Daemon) -> None:
    # More than are kept.
    assert [len(daemon.call("get_large", size)) for size in range(400)] == list(range(400))


def test_addresses_are_listed_and_looked_at_now_and_then(daemon: Daemon) -> None:
    calls = range(100)
    assert max(daemon.call("get_listings", call) for call in calls) <= 2
    assert max(daemon.call("get_looks", call) for call in calls) <= 2


def test_silent_and_slow_clients_delay_no_other(daemon: Daemon) -> None:
    with ExitStack() as stack:
        for sent in (b"", b"POST", request("get_count")[:-1], b"\r\n", b"POST / HTTP/1.0\r\n"):
            for _ in range(10):
                stack.enter_context(daemon.connect()).sendall(sent)
        # Waiting for each of them in turn would take longer than the limit of this connection.
        with daemon.connect() as client:
            client.sendall(request("get_large", (4,)))
            assert read_answer(client) == "xxxx"


def test_clients_that_do_not_read_delay_no_other(daemon: Daemon) -> None:
    size = 30_000_000
    with daemon.connect() as deaf:
        deaf.sendall(request("get_large", (size,)))
        assert daemon.call("get_large", 1) == "x"
        # Nor is it forgotten, and the answer is whole.
        assert len(read_answer(deaf)) == size


@pytest.mark.parametrize(
    "sent",
    [
        b"x" * (1 << 17),
        b"POST /ros2cli/ HTTP/1.0\r\nContent-Length: 99999999\r\n\r\n",
        b"POST /ros2cli/ HTTP/1.0\r\n" + b"A: b\r\n" * 20_000 + b"\r\n",
    ],
)
def test_what_is_too_large_is_refused(daemon: Daemon, sent: bytes) -> None:
    with daemon.connect() as client:
        try:
            client.sendall(sent)
            answer = client.recv(1 << 16)
        except ConnectionError:
            # Closed with bytes of ours unread.
            answer = b""
        # 413, 414 or 431: body, request line or headers.
        assert answer == b"" or answer.startswith(b"HTTP/1.0 4")
    assert daemon.call("get_large", 1) == "x"


def test_a_crowd_is_queued_while_the_daemon_is_busy(daemon: Daemon) -> None:
    os.kill(daemon.process.pid, signal.SIGSTOP)
    with ExitStack() as stack:
        # As many as any kernel's own limit allows.
        crowd = [stack.enter_context(daemon.connect()) for _ in range(120)]
        for client in crowd:
            client.sendall(request("get_large", (5,)))
        os.kill(daemon.process.pid, signal.SIGCONT)
        assert [read_answer(client) for client in crowd] == ["xxxxx"] * 120


def test_the_port_is_free_after_many_calls(daemon: Daemon) -> None:
    for call in range(50):
        daemon.call("get_large", call)
    daemon.call("system.shutdown")
    daemon.end()
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    local = f"0100007F:{daemon.port:04X}"
    assert [row for row in rows if row[1] == local and row[3] == TIME_WAIT] == []
    # What a starting daemon does, without SO_REUSEADDR.
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", daemon.port))


def test_calls_are_not_printed_and_shutdown_is_answered(daemon: Daemon) -> None:
    for call in range(5):
        daemon.call("get_large", call)
    assert daemon.call("system.shutdown") is None
    assert daemon.end() == ["ended"]


@pytest.mark.parametrize("environment", [{}, {"LIKE_HUMBLE": "1"}])
def test_a_signal_ends_it(start: Start, environment: dict[str, str]) -> None:
    daemon = start(**environment)
    assert daemon.call("get_large", 1) == "x"
    daemon.process.send_signal(signal.SIGTERM)
    assert daemon.end() == ["ended"]


def test_like_humble_it_ends_after_its_idle_time_and_not_before(start: Start) -> None:
    daemon = start(LIKE_HUMBLE="1", TIMEOUT="1.5")
    begin = time.monotonic()
    # Silent connections are no use.
    with daemon.connect():
        assert daemon.end() == ["ended"]
    assert time.monotonic() - begin >= 1.0


def test_clients_that_go_away_leave_nothing_behind(daemon: Daemon) -> None:
    descriptors = Path(f"/proc/{daemon.process.pid}/fd")
    daemon.call("get_large", 1)
    deadline = time.monotonic() + LIMIT
    before = len(list(descriptors.iterdir()))
    for _ in range(100):
        with daemon.connect() as client:
            client.sendall(b"POST")
    while len(list(descriptors.iterdir())) > before:
        daemon.call("get_large", 1)
        assert time.monotonic() < deadline
