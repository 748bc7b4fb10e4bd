"""Requests are cut out of any stream of bytes, within bounds."""

from __future__ import annotations

import gzip

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.graph_daemon.server.http import (
    LONGEST_BODY,
    LONGEST_HEAD,
    Rejection,
    Request,
    RequestReader,
    response,
)

HEAD = b"POST /ros2cli/ HTTP/1.1\r\n"


def request(body: bytes, *headers: bytes) -> bytes:
    lines = b"".join(header + b"\r\n" for header in headers)
    return HEAD + lines + b"Content-Length: %d\r\n\r\n" % len(body) + body


def results(data: bytes, sizes: list[int]) -> list[Request | Rejection]:
    """What a reader finds when the data come in pieces of these sizes."""
    reader = RequestReader()
    found: list[Request | Rejection] = []
    start = 0
    for size in [*sizes, len(data)]:
        reader.feed(data[start : start + size])
        start += size
        while (result := reader.next()) is not None:
            found.append(result)
            if isinstance(result, Rejection):
                return found
        assert len(reader) <= LONGEST_HEAD + LONGEST_BODY + size
    return found


pieces = st.lists(st.integers(1, 300), max_size=50)


@given(st.lists(st.binary(max_size=2_000), max_size=5), pieces)
def test_requests_come_whole_however_the_stream_is_cut(
    bodies: list[bytes], sizes: list[int]
) -> None:
    stream = b"".join(map(request, bodies))
    assert results(stream, sizes) == [Request(body, keep_alive=True) for body in bodies]


@given(st.binary(max_size=5_000), pieces)
def test_whatever_comes_is_read_or_rejected(data: bytes, sizes: list[int]) -> None:
    whole, cut = results(data, []), results(data, sizes)
    assert whole == cut
    for result in whole[:-1]:
        assert isinstance(result, Request)


@given(st.lists(st.sampled_from([b"POST", b" ", b"/ros2cli/", b"HTTP/1.1", b"\r\n", b"\n", b":"])))
def test_pieces_of_a_head_in_any_order_are_survived(parts: list[bytes]) -> None:
    results(b"".join(parts), [])


@pytest.mark.parametrize(
    ("stream", "status"),
    [
        (b"\x16\x03\x01\x02\x00\r\n\r\n", 400),
        (b"POST /ros2cli/\r\n\r\n", 400),
        (b"POST  /ros2cli/ HTTP/1.1\r\n\r\n", 400),
        (b"POST /ros2cli/ HTTP/2.0\r\n\r\n", 400),
        (HEAD + b"no colon\r\n\r\n", 400),
        (HEAD + b" Folded: 1\r\n\r\n", 400),
        (HEAD + b"Content-Length : 1\r\n\r\n", 400),
        (HEAD + b"Content-Length: 1\r\nContent-Length: 2\r\n\r\n", 400),
        (HEAD + b"Content-Length: -1\r\n\r\n", 400),
        (HEAD + b"Content-Length: 1e3\r\n\r\n", 400),
        (HEAD + "Content-Length: ٣\r\n\r\n".encode(), 400),
        (b"GET /ros2cli/ HTTP/1.1\r\n\r\n", 501),
        (b"DELETE /ros2cli/ HTTP/1.1\r\n\r\n", 501),
        (b"POST /ros2cli/../ HTTP/1.1\r\nContent-Length: 0\r\n\r\n", 404),
        (b"POST /ros2cli/?x HTTP/1.1\r\nContent-Length: 0\r\n\r\n", 404),
        (HEAD + b"Transfer-Encoding: chunked\r\n\r\n", 501),
        (HEAD + b"Content-Length: 0\r\nContent-Encoding: br\r\n\r\n", 501),
        (HEAD + b"\r\n", 411),
        (HEAD + b"Content-Length: %d\r\n\r\n" % (LONGEST_BODY + 1), 413),
        (HEAD + b"Content-Length: 999999999999999999\r\n\r\n", 413),
        (HEAD + b"Content-Length: " + b"9" * 5_000 + b"\r\n\r\n", 400),
        (b"x" * (LONGEST_HEAD + 1), 431),
        (HEAD + b"A: " + b"x" * LONGEST_HEAD, 431),
        (HEAD + b"A: " + b"x" * LONGEST_HEAD + b"\r\n\r\n", 431),
    ],
)
def test_a_bad_request_is_rejected_and_nothing_after_it_read(stream: bytes, status: int) -> None:
    reader = RequestReader()
    reader.feed(stream)
    rejection = reader.next()
    assert isinstance(rejection, Rejection)
    assert rejection.status == status
    assert rejection.response.startswith(b"HTTP/1.1 %d " % status)
    reader.feed(request(b"<x/>"))
    assert reader.next() == rejection
    assert len(reader) == 0


def test_the_longest_body_is_taken() -> None:
    body = b"x" * LONGEST_BODY
    assert results(request(body), []) == [Request(body, keep_alive=True)]


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
    assert results(stream, []) == [Request(b"", keep_alive=keep)]


@given(st.binary(max_size=3_000))
def test_a_packed_body_is_unpacked(body: bytes) -> None:
    packed = gzip.compress(body)
    assert results(request(packed, b"Content-Encoding: gzip"), []) == [
        Request(body, keep_alive=True)
    ]


@pytest.mark.parametrize(
    "packed",
    [
        gzip.compress(b"\0" * (LONGEST_BODY + 1)),
        gzip.compress(b"\0" * 10_000_000),
        gzip.compress(b"x")[:-3],
        b"",
        b"no gzip",
    ],
    # gzip puts the time into its header: the bytes are no name.
    ids=["too large", "far too large", "cut", "empty", "no gzip"],
)
def test_a_packed_body_that_is_broken_or_too_large_is_rejected(packed: bytes) -> None:
    (found,) = results(request(packed, b"Content-Encoding: gzip"), [])
    assert isinstance(found, Rejection)


def test_a_response_has_its_length_and_whether_it_is_the_last() -> None:
    assert response(b"body", keep_alive=True).endswith(b"Content-Length: 4\r\n\r\nbody")
    assert b"\r\nConnection: close\r\n\r\n" in response(b"body", keep_alive=False)


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
    (found,) = results(request(b"<x/>", *headers), [])
    assert isinstance(found, Rejection)
    assert found.status == 403


def test_two_hosts_are_no_request() -> None:
    (found,) = results(request(b"<x/>", b"Host: localhost", b"Host: example.org"), [])
    assert isinstance(found, Rejection)
    assert found.status == 400


@pytest.mark.parametrize(
    "host", [b"127.0.0.1:11511", b"localhost:11511", b"LOCALHOST", b"[::1]:11511", b"127.0.0.1"]
)
def test_this_machine_s_names_are_served(host: bytes) -> None:
    assert results(request(b"<x/>", b"Host: " + host), []) == [Request(b"<x/>", keep_alive=True)]
