"""The little of HTTP that XML-RPC needs, as text: heads of requests, and responses; POST only.

Rejections are those of Python's XML-RPC server where it has them, so that clients which probe see
the same; what it answers with 500, or not at all, has a number of its own here.
"""

from __future__ import annotations

import re
from typing import Final

from play_launch.graph_daemon.contract import PATH

LONGEST_HEAD: Final = 8 * 1024
"""Bytes of request line and headers."""
LONGEST_BODY: Final = 32 * 1024
"""Bytes of a request's body; a call of ros2cli has some hundred."""

END_OF_HEAD: Final = re.compile(rb"\r?\n\r?\n")
_REQUEST_LINE: Final = re.compile(rb"([!-~]+) ([!-~]+) HTTP/(1\.[01])")
_OUR_HOST: Final = re.compile(rb"(?:127\.0\.0\.1|localhost|\[::1\])(?::[0-9]{1,5})?", re.IGNORECASE)
_LENGTH: Final = re.compile(rb"[0-9]{1,18}")


class Rejection(Exception):  # noqa: N818 - HTTP's own word
    """What is wrong with a request; the connection cannot be used after it."""

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(status, reason)
        # The text of 404 is the one of Python's XML-RPC server.
        text = "No such page" if status == 404 else reason
        self.status = status
        self.response = (
            f"HTTP/1.1 {status} {reason}\r\nContent-Type: text/plain\r\n"
            f"Content-Length: {len(text)}\r\nConnection: close\r\n\r\n{text}"
        ).encode("ascii")
        """The bytes to answer with."""


def response(body: bytes, *, keep_alive: bool) -> bytes:
    ending = b"\r\n\r\n" if keep_alive else b"\r\nConnection: close\r\n\r\n"
    return b"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nContent-Length: %d%b%b" % (
        len(body),
        ending,
        body,
    )


def parse_head(text: bytes) -> tuple[int, bool]:
    """Read a head without the empty line at its end; raises `Rejection`.

    Returns the length of the body, and whether another request may follow.
    """
    first, *lines = text.replace(b"\r\n", b"\n").split(b"\n")
    line = _REQUEST_LINE.fullmatch(first)
    if line is None:
        raise Rejection(400, "Bad Request")
    method, path, version = line.groups()
    headers: dict[bytes, bytes] = {}
    for header in lines:
        name, colon, value = header.partition(b":")
        if not colon or not name or name != name.strip():
            raise Rejection(400, "Bad Request")
        name = name.lower()
        # Two lengths in one request have been the way into many servers.
        value = value.strip()
        if name in {b"content-length", b"host"} and headers.get(name, value) != value:
            raise Rejection(400, "Bad Request")
        headers[name] = value
    # Only browsers send an origin: a page of the web may not ask, and not shut the daemon down.
    # Nor may one whose name was made to point to this machine.
    if b"origin" in headers or not _OUR_HOST.fullmatch(headers.get(b"host", b"localhost")):
        raise Rejection(403, "Forbidden")
    if method != b"POST":
        raise Rejection(501, "Unsupported method")
    if path != PATH.encode("ascii"):
        raise Rejection(404, "Not Found")
    if b"transfer-encoding" in headers:
        raise Rejection(501, "Transfer encodings are not supported")
    length = headers.get(b"content-length")
    if length is None:
        raise Rejection(411, "Length Required")
    if not _LENGTH.fullmatch(length):
        raise Rejection(400, "Bad Request")
    if int(length) > LONGEST_BODY:
        raise Rejection(413, "Content Too Large")
    if headers.get(b"content-encoding", b"identity").lower() != b"identity":
        raise Rejection(501, "Encoding not supported")
    wish = headers.get(b"connection", b"").lower()
    return int(length), b"keep-alive" in wish if version == b"1.0" else b"close" not in wish
