"""Requests are cut out of any stream of bytes, within bounds; over a socket of the real server."""

from __future__ import annotations

import asyncio
import re
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.graph_daemon.http_head import LONGEST_BODY, LONGEST_HEAD
from tests.graph_daemon.test_http_server import run, serving

HEAD = b"POST /ros2cli/ HTTP/1.1\r\n"
MOST_HELD = LONGEST_HEAD + 2 * LONGEST_BODY + 32 * 1024
"""Bytes for one client: a request, an answer as large, and what was read with them."""
_STATUS = re.compile(rb"HTTP/1\.1 ([0-9]{3}) ")


def request(body: bytes, *headers: bytes, head: bytes = HEAD) -> bytes:
    lines = b"".join(header + b"\r\n" for header in headers)
    return head + lines + b"Content-Length: %d\r\n\r\n" % len(body) + body


def answer(body: bytes, *, keep: bool = True) -> bytes:
    """What the server answers, which gives back what it is asked."""
    ending = b"" if keep else b"Connection: close\r\n"
    return b"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nContent-Length: %d\r\n%b\r\n%b" % (
        len(body),
        ending,
        body,
    )


def answers(data: bytes, sizes: list[int] | None = None) -> bytes:
    """All that a server sends when the data come in pieces of these sizes, and then the end."""
    received = bytearray()

    async def scenario() -> None:
        loop = asyncio.get_running_loop()
        async with serving(answer=lambda body: body) as clients:
            with socket.create_connection(("127.0.0.1", clients.port)) as client:
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                client.setblocking(False)

                async def read() -> None:
                    while chunk := await loop.sock_recv(client, 1 << 20):
                        received.extend(chunk)

                reading = loop.create_task(read())
                start = 0
                for size in [*(sizes or []), len(data)]:
                    await loop.sock_sendall(client, data[start : start + size])
                    start += size
                    # The loop looks at the server's socket in between.
                    for _ in range(4):
                        await asyncio.sleep(0)
                        assert clients.server.held <= MOST_HELD
                client.shutdown(socket.SHUT_WR)
                await reading

    run(scenario)
    return bytes(received)


def status(data: bytes) -> int:
    """The status of the only answer."""
    found = _STATUS.findall(answers(data))
    assert len(found) == 1
    return int(found[0])


pieces = st.lists(st.integers(1, 300), max_size=50) | st.lists(st.integers(1, 4), max_size=100)
bodies = st.binary(max_size=2_000)
ODD_HEADERS = (
    b"Connection: close",
    b"Content-Length: 5",
    b"Transfer-Encoding: chunked",
    b"Origin: null",
    b"Host: localhost",
    b"Host: example.org",
    b"no colon",
    b"Long: " + b"x" * LONGEST_HEAD,
)
requests = st.one_of(
    bodies.map(request),
    st.builds(request, bodies, st.sampled_from(ODD_HEADERS), st.sampled_from(ODD_HEADERS)),
    st.builds(request, st.just(b"x" * LONGEST_BODY)),
)
fragments = st.one_of(
    requests,
    st.sampled_from([HEAD, b"POST", b" ", b"HTTP/1.1", b"\r\n", b"\n", b"\r", b":", b"\0"]),
    st.binary(max_size=300),
)


@given(st.lists(bodies, max_size=5), pieces)
def test_requests_come_whole_however_the_stream_is_cut(
    bodies: list[bytes], sizes: list[int]
) -> None:
    assert answers(b"".join(map(request, bodies)), sizes) == b"".join(map(answer, bodies))


@given(st.lists(fragments, max_size=6).map(b"".join), pieces)
def test_whatever_comes_is_answered_the_same_however_it_is_cut(
    stream: bytes, sizes: list[int]
) -> None:
    assert answers(stream, sizes) == answers(stream)


@pytest.mark.parametrize(
    ("stream", "expected"),
    [
        (b"\x16\x03\x01\x02\x00\r\n\r\n", 400),
        (b"POST /ros2cli/\r\n\r\n", 400),
        (b"POST  /ros2cli/ HTTP/1.1\r\n\r\n", 400),
        (b"POST /ros2cli/ HTTP/2.0\r\n\r\n", 400),
        (HEAD + b"no colon\r\n\r\n", 400),
        (HEAD + b" Folded: 1\r\n\r\n", 400),
        (HEAD + b"Content-Length : 1\r\n\r\n", 400),
        (HEAD + b"Content-Length: 1\r\nContent-Length: 2\r\n\r\n", 400),
        (HEAD + b"Host: localhost\r\nHost: example.org\r\n\r\n", 400),
        (HEAD + b"Content-Length: -1\r\n\r\n", 400),
        (HEAD + b"Content-Length: 1e3\r\n\r\n", 400),
        (HEAD + "Content-Length: ٣\r\n\r\n".encode(), 400),
        (b"GET /ros2cli/ HTTP/1.1\r\n\r\n", 501),
        (b"DELETE /ros2cli/ HTTP/1.1\r\n\r\n", 501),
        (b"POST /ros2cli/../ HTTP/1.1\r\nContent-Length: 0\r\n\r\n", 404),
        (b"POST /ros2cli/?x HTTP/1.1\r\nContent-Length: 0\r\n\r\n", 404),
        (HEAD + b"Transfer-Encoding: chunked\r\n\r\n", 501),
        (HEAD + b"Content-Length: 0\r\nContent-Encoding: gzip\r\n\r\n", 501),
        (HEAD + b"\r\n", 411),
        (HEAD + b"Content-Length: %d\r\n\r\n" % (LONGEST_BODY + 1), 413),
        (HEAD + b"Content-Length: 999999999999999999\r\n\r\n", 413),
        (HEAD + b"Content-Length: " + b"9" * 5_000 + b"\r\n\r\n", 400),
        (b"x" * (LONGEST_HEAD + 1), 431),
        (HEAD + b"A: " + b"x" * LONGEST_HEAD, 431),
        (HEAD + b"A: " + b"x" * LONGEST_HEAD + b"\r\n\r\n", 431),
    ],
)
def test_a_bad_request_is_rejected_and_nothing_after_it_read(stream: bytes, expected: int) -> None:
    assert status(stream + request(b"<x/>")) == expected


def test_the_longest_body_is_taken() -> None:
    body = b"x" * LONGEST_BODY
    assert answers(request(body)) == answer(body)


@pytest.mark.parametrize(
    ("stream", "keep"),
    [
        (b"POST /ros2cli/ HTTP/1.1\r\nContent-Length: 0\r\n\r\n", True),
        (b"POST /ros2cli/ HTTP/1.1\r\nConnection: Close\r\nContent-Length: 0\r\n\r\n", False),
        (b"POST /ros2cli/ HTTP/1.0\r\nContent-Length: 0\r\n\r\n", False),
        (b"POST /ros2cli/ HTTP/1.0\r\nConnection: keep-alive\r\nContent-Length: 0\r\n\r\n", True),
        (b"\r\nPOST /ros2cli/ HTTP/1.1\ncontent-length:0\n\n", True),
    ],
)
def test_the_client_says_whether_the_connection_is_kept(stream: bytes, keep: bool) -> None:
    once = answer(b"", keep=keep)
    assert answers(2 * stream) == (2 * once if keep else once)


@pytest.mark.parametrize(
    "headers",
    [
        [b"Origin: http://example.org"],
        [b"Origin: null"],
        [b"Host: 127.0.0.1:11511", b"Origin: http://127.0.0.1:11511"],
        [b"Host: example.org"],
        [b"Host: 127.0.0.1.example.org:11511"],
        [b"Host: 192.168.1.2:11511"],
        [b"Host: "],
    ],
)
def test_what_a_page_of_the_web_sends_is_forbidden(headers: list[bytes]) -> None:
    assert status(request(b"<x/>", *headers)) == 403


@pytest.mark.parametrize(
    "host", [b"127.0.0.1:11511", b"localhost:11511", b"LOCALHOST", b"[::1]:11511", b"127.0.0.1"]
)
def test_this_machine_s_names_are_served(host: bytes) -> None:
    assert answers(request(b"<x/>", b"Host: " + host)) == answer(b"<x/>")
