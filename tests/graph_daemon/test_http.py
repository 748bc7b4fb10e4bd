"""Bounds and guards of the server, over sockets."""

from __future__ import annotations

import gzip
import http.client
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from play_launch.graph_daemon import http_server
from play_launch.graph_daemon.contract import PATH
from play_launch.graph_daemon.http_server import LARGEST_BODY, Server

WAIT = 60.0


@contextmanager
def serving(
    answer: Callable[[bytes], bytes] = lambda body: body, connections: int = 100
) -> Iterator[Server]:
    """A server that answers with the request's body."""
    server = Server(socket.create_server(("127.0.0.1", 0)), answer, connections)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        thread.join(WAIT)
        server.close()


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving() as server:
        yield server


def connect(server: Server) -> socket.socket:
    return socket.create_connection(server.server_address[:2], timeout=WAIT)  # type: ignore[arg-type]


def post(
    server: Server, body: bytes, headers: dict[str, str], path: str = PATH
) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection(*server.server_address[:2], timeout=WAIT)  # type: ignore[arg-type]
    try:
        connection.request("POST", PATH, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"Host": "localhost:11511"}, 200),
        ({"Host": "[::1]"}, 200),
        ({"Host": "example.org"}, 403),
        ({"Host": "127.0.0.1.example.org"}, 403),
        ({"Origin": "null"}, 403),
        ({"Content-Encoding": "br"}, 501),
        ({"Transfer-Encoding": "chunked"}, 501),
        ({"Content-Length": "-5"}, 400),
        ({"Content-Length": str(LARGEST_BODY + 1)}, 413),
        ({"Content-Encoding": "gzip"}, 400),
    ],
)
def test_guards(server: Server, headers: dict[str, str], status: int) -> None:
    assert post(server, b"body!", headers)[0] == status


def test_two_lengths_are_refused(server: Server) -> None:
    head = f"POST {PATH} HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\nab"
    with connect(server) as client:
        client.sendall(head.encode())
        assert client.recv(100).startswith(b"HTTP/1.1 400 ")


def test_no_length_is_refused(server: Server) -> None:
    with connect(server) as client:
        client.sendall(f"POST {PATH} HTTP/1.1\r\n\r\n".encode())
        assert client.recv(100).startswith(b"HTTP/1.1 411 ")


def test_packed_requests_are_unpacked_within_the_limit(server: Server) -> None:
    packed = {"Content-Encoding": "gzip"}
    assert post(server, gzip.compress(b"call"), packed) == (200, b"call")
    assert post(server, gzip.compress(bytes(LARGEST_BODY)), packed)[0] == 200
    assert post(server, gzip.compress(bytes(LARGEST_BODY + 1)), packed)[0] == 400


@settings(max_examples=30, deadline=None)
@given(st.lists(st.binary(max_size=500), max_size=4), st.lists(st.integers(1, 300), max_size=20))
def test_requests_are_read_however_they_are_cut(
    server: Server, bodies: list[bytes], sizes: list[int]
) -> None:
    head = f"POST {PATH} HTTP/1.1\r\nContent-Length: "
    stream = b"".join(f"{head}{len(body)}\r\n\r\n".encode() + body for body in bodies)
    received = bytearray()
    with connect(server) as client:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for size in [*sizes, len(stream)]:
            client.sendall(stream[:size])
            stream = stream[size:]
        client.shutdown(socket.SHUT_WR)
        while chunk := client.recv(1 << 16):
            received += chunk
    assert received.count(b"HTTP/1.1 200 OK") == len(bodies)
    assert all(body in received for body in bodies)


@pytest.mark.parametrize("version", ["HTTP/1.0", "HTTP/1.1"])
def test_the_client_closes_first(version: str) -> None:
    """Otherwise the port stays in TIME_WAIT, and ros2cli's daemon cannot start."""
    with serving() as server:
        where = server.server_address
        with connect(server) as client:
            close = "Connection: close\r\n"
            client.sendall(f"POST {PATH} {version}\r\n{close}Content-Length: 2\r\n\r\nab".encode())
            reply = b""
            while not reply.endswith(b"ab"):
                reply += client.recv(1000)
    with socket.socket() as stock:  # binds without SO_REUSEADDR
        stock.bind(where)


def test_a_silent_client_is_reset(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_server, "CLIENT_TIMEOUT", 0.1)
    monkeypatch.setattr(http_server._Handler, "timeout", 0.1)
    with serving() as server, connect(server) as client, pytest.raises(ConnectionResetError):
        client.recv(1)


def test_the_oldest_connection_makes_room_for_a_new_one() -> None:
    with serving(connections=5) as server, ExitStack() as stack:
        clients = [stack.enter_context(connect(server)) for _ in range(5)]
        assert post(server, b"new", {}) == (200, b"new")
        assert server.resets == 1
        with suppress(ConnectionResetError):
            assert clients[0].recv(1) == b""
        assert server.connections >= 4


def test_a_slow_answer_keeps_no_other_client_waiting() -> None:
    release = threading.Event()

    def answer(body: bytes) -> bytes:
        if body == b"slow":
            assert release.wait(WAIT)
        return body

    with serving(answer) as server, connect(server) as client:
        client.sendall(f"POST {PATH} HTTP/1.1\r\nContent-Length: 4\r\n\r\nslow".encode())
        assert post(server, b"quick", {}) == (200, b"quick")
        release.set()
        assert client.recv(1000).endswith(b"slow")


def test_an_answer_under_way_is_given_at_the_end() -> None:
    reached, release = threading.Event(), threading.Event()

    def answer(body: bytes) -> bytes:
        reached.set()
        assert release.wait(WAIT)
        return body

    with ExitStack() as stack:
        server = stack.enter_context(serving(answer))
        client = stack.enter_context(connect(server))
        client.sendall(f"POST {PATH} HTTP/1.1\r\nContent-Length: 4\r\n\r\nbody".encode())
        assert reached.wait(WAIT)
        server.stop_listening()
        with pytest.raises(ConnectionRefusedError):
            connect(server)
        release.set()
        assert client.recv(1000).endswith(b"body")
