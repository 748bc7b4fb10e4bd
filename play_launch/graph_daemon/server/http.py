"""The little of HTTP that XML-RPC needs, with bounds: one request after the other, POST only.

Rejections are those of Python's XML-RPC server where it has them, so that clients which probe see
the same; what it answers with 500, or not at all, has a number of its own here.
"""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from typing import Final

from play_launch.graph_daemon.address import PATH

LONGEST_HEAD: Final = 8 * 1024
"""Bytes of request line and headers."""
LONGEST_BODY: Final = 32 * 1024
"""Bytes of a request's body, also after unpacking; a call of ros2cli has some hundred."""

_END_OF_HEAD: Final = re.compile(rb"\r?\n\r?\n")
_REQUEST_LINE: Final = re.compile(rb"([!-~]+) ([!-~]+) HTTP/(1\.[01])")
_OUR_HOST: Final = re.compile(rb"(?:127\.0\.0\.1|localhost|\[::1\])(?::[0-9]{1,5})?", re.IGNORECASE)
_LENGTH: Final = re.compile(rb"[0-9]{1,18}")


@dataclass(frozen=True, slots=True)
class Request:
    """A call's body, and whether the client wants to keep the connection."""

    body: bytes
    keep_alive: bool


@dataclass(frozen=True, slots=True)
class Rejection:
    """What is wrong with a request; the connection cannot be used after it."""

    status: int
    reason: str

    @property
    def response(self) -> bytes:
        """The bytes to answer with."""
        # The text of 404 is the one of Python's XML-RPC server.
        text = "No such page" if self.status == 404 else self.reason
        head = (
            f"HTTP/1.1 {self.status} {self.reason}\r\nContent-Type: text/plain\r\n"
            f"Content-Length: {len(text)}\r\nConnection: close\r\n\r\n"
        )
        return (head + text).encode("ascii")


def response(body: bytes, *, keep_alive: bool) -> bytes:
    """Return head and body of an answer to a call."""
    ending = b"\r\n\r\n" if keep_alive else b"\r\nConnection: close\r\n\r\n"
    return b"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nContent-Length: %d%b%b" % (
        len(body),
        ending,
        body,
    )


@dataclass(frozen=True, slots=True)
class _Head:
    length: int
    packed: bool
    keep_alive: bool


class RequestReader:
    """Cuts a stream of bytes into requests; holds at most one request's worth and one read."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._searched = 0
        self._head: _Head | None = None
        self._rejection: Rejection | None = None

    def __len__(self) -> int:
        """How many bytes are held."""
        return len(self._buffer)

    def feed(self, data: bytes | memoryview) -> None:
        """Take bytes as they came; after a rejection they are dropped."""
        if self._rejection is None:
            self._buffer += data

    def next(self) -> Request | Rejection | None:
        """Return the next request; None while it is not complete.

        The first rejection is the last result: what follows it has no meaning.
        """
        if self._rejection is not None:
            return self._rejection
        if self._head is None:
            found = self._read_head()
            if isinstance(found, Rejection):
                return self._reject(found)
            if found is None:
                return None
            self._head = found
        if len(self._buffer) < self._head.length:
            return None
        head, self._head = self._head, None
        body = bytes(self._buffer[: head.length])
        del self._buffer[: head.length]
        if head.packed:
            unpacked = _unpack(body)
            if unpacked is None:
                return self._reject(Rejection(400, "Bad gzip content"))
            body = unpacked
        return Request(body, head.keep_alive)

    def _read_head(self) -> _Head | Rejection | None:
        # Python's clients end a request with CRLF; some old ones send one more.
        while self._buffer[:2] == b"\r\n":
            del self._buffer[:2]
        # A pattern of four bytes may have begun in what was searched before.
        end = _END_OF_HEAD.search(self._buffer, max(0, self._searched - 3))
        if (end.end() if end else len(self._buffer)) > LONGEST_HEAD:
            return Rejection(431, "Request Header Fields Too Large")
        if end is None:
            self._searched = len(self._buffer)
            return None
        text = bytes(self._buffer[: end.start()])
        del self._buffer[: end.end()]
        self._searched = 0
        return _parse_head(text)

    def _reject(self, rejection: Rejection) -> Rejection:
        self._rejection = rejection
        self._buffer.clear()
        return rejection


def _parse_head(text: bytes) -> _Head | Rejection:
    first, *lines = text.replace(b"\r\n", b"\n").split(b"\n")
    line = _REQUEST_LINE.fullmatch(first)
    if line is None:
        return Rejection(400, "Bad Request")
    method, path, version = line.groups()
    headers: dict[bytes, bytes] = {}
    for header in lines:
        name, colon, value = header.partition(b":")
        if not colon or not name or name != name.strip():
            return Rejection(400, "Bad Request")
        name = name.lower()
        # Two lengths in one request have been the way into many servers.
        value = value.strip()
        if name in {b"content-length", b"host"} and headers.get(name, value) != value:
            return Rejection(400, "Bad Request")
        headers[name] = value
    # Only browsers send an origin: a page of the web may not ask, and not shut the daemon down.
    # Nor may one whose name was made to point to this machine.
    if b"origin" in headers or not _OUR_HOST.fullmatch(headers.get(b"host", b"localhost")):
        return Rejection(403, "Forbidden")
    if method != b"POST":
        return Rejection(501, "Unsupported method")
    if path != PATH.encode("ascii"):
        return Rejection(404, "Not Found")
    if b"transfer-encoding" in headers:
        return Rejection(501, "Transfer encodings are not supported")
    length = headers.get(b"content-length")
    if length is None:
        return Rejection(411, "Length Required")
    if not _LENGTH.fullmatch(length):
        return Rejection(400, "Bad Request")
    if int(length) > LONGEST_BODY:
        return Rejection(413, "Content Too Large")
    encoding = headers.get(b"content-encoding", b"identity").lower()
    if encoding not in {b"identity", b"gzip"}:
        return Rejection(501, "Encoding not supported")
    wish = headers.get(b"connection", b"").lower()
    keep_alive = b"keep-alive" in wish if version == b"1.0" else b"close" not in wish
    return _Head(int(length), encoding == b"gzip", keep_alive)


def _unpack(packed: bytes) -> bytes | None:
    """Unpack gzip; None when it is broken or unpacks to more than the longest body."""
    unpacker = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
    try:
        body = unpacker.decompress(packed, LONGEST_BODY + 1)
    except zlib.error:
        return None
    return body if unpacker.eof and len(body) <= LONGEST_BODY else None
