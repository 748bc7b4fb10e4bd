"""The little of HTTP that XML-RPC needs, as text: heads of requests, and responses; POST only.

Rejections are those of Python's XML-RPC server where it has them, so that clients which probe see
the same; what it answers with 500, or not at all, has a number of its own here.
"""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from typing import Final

from play_launch.graph_daemon.contract import PATH

LONGEST_HEAD: Final = 8 * 1024
"""Bytes of request line and headers."""
LONGEST_BODY: Final = 32 * 1024
"""Bytes of a request's body, also after unpacking; a call of ros2cli has some hundred."""

END_OF_HEAD: Final = re.compile(rb"\r?\n\r?\n")
CONSENT: Final = b"HTTP/1.1 100 Continue\r\n\r\n"
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
    """Return head and body of an answer to a call."""
    ending = b"\r\n\r\n" if keep_alive else b"\r\nConnection: close\r\n\r\n"
    return b"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nContent-Length: %d%b%b" % (
        len(body),
        ending,
        body,
    )


@dataclass(frozen=True, slots=True)
class Head:
    """Length and form of a request's body, and what may follow it, by its head."""

    length: int
    is_packed: bool
    keep_alive: bool
    awaits_consent: bool
    """Whether the client sends the body only after `CONSENT`."""


def parse_head(text: bytes) -> Head:
    """Read a head without the empty line at its end; raises `Rejection`."""
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
    encoding = headers.get(b"content-encoding", b"identity").lower()
    if encoding not in {b"identity", b"gzip"}:
        raise Rejection(501, "Encoding not supported")
    wish = headers.get(b"connection", b"").lower()
    is_old = version == b"1.0"
    return Head(
        length=int(length),
        is_packed=encoding == b"gzip",
        keep_alive=b"keep-alive" in wish if is_old else b"close" not in wish,
        awaits_consent=not is_old and headers.get(b"expect", b"").lower() == b"100-continue",
    )


def unpack(packed: bytes) -> bytes:
    """Unpack gzip; raises `Rejection` when it is broken or unpacks to more than `LONGEST_BODY`."""
    unpacker = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
    try:
        body = unpacker.decompress(packed, LONGEST_BODY + 1)
    except zlib.error:
        body = b""
    if not unpacker.eof or len(body) > LONGEST_BODY:
        raise Rejection(400, "Bad gzip content")
    return body
