"""The standard library's HTTP server, a thread a connection, with bounds for local clients.

The side that closes a TCP connection first keeps its port in TIME_WAIT for a minute, and ros2cli's
daemon cannot start while our port is busy. So the client closes first, or the connection is reset.
"""

from __future__ import annotations

import contextlib
import http.server
import logging
import re
import socket
import socketserver
import struct
import sys
import threading
import time
import zlib
from typing import TYPE_CHECKING, Any, Final

from play_launch.graph_daemon.contract import BACKLOG, PATH

if TYPE_CHECKING:
    from collections.abc import Callable

LARGEST_BODY: Final = 32 * 1024
"""Bytes of a request's body, also after unpacking; a call of ros2cli has some hundred."""
CLIENT_TIMEOUT: Final = 10.0
"""Seconds without progress for a request, for an answer, and for closing after the last one."""
CONNECTIONS: Final = 256
"""Connections at once, each with a thread; where one more comes, the oldest is reset."""
_CLOSE_TIMEOUT: Final = 1.0
"""Seconds for answers that are under way when the daemon ends."""
_ACCEPT_PAUSE: Final = 0.1
_OUR_HOST: Final = re.compile(r"(?:127\.0\.0\.1|localhost|\[::1\])(?::[0-9]{1,5})?", re.IGNORECASE)
_LENGTH: Final = re.compile(r"[0-9]{1,18}")
_RESET_ON_CLOSE: Final = struct.pack("ii", 1, 0)
_CLOSE_IN_ORDER: Final = struct.pack("ii", 0, 0)
_log = logging.getLogger(__name__)


class Server(socketserver.ThreadingMixIn, socketserver.TCPServer):
    """Passes the body of each request to ``answer``, in a thread for each connection.

    Args:
        listener: Bound and listening; it belongs to the server from now on.
        answer: Returns the body of the response; called in the connections' threads.
        connections: Limit of connections at once.
    """

    daemon_threads = True
    block_on_close = False

    def __init__(
        self,
        listener: socket.socket,
        answer: Callable[[bytes], bytes],
        connections: int = CONNECTIONS,
    ) -> None:
        self.answer = answer
        self.requests = 0
        """Number of requests that were answered."""
        self.resets = 0
        """Number of connections that were reset because there were too many."""
        self._free = threading.Semaphore(connections)
        self._open: dict[socket.socket, bool] = {}
        """The connections, oldest first, and whether they are being ended from here."""
        self._changed = threading.Condition()
        super().__init__(listener.getsockname(), _Handler, bind_and_activate=False)
        self.socket.close()
        self.socket = listener
        listener.listen(BACKLOG)

    @property
    def connections(self) -> int:
        """The number of connections."""
        return len(self._open)

    def stop_listening(self) -> None:
        """Refuse connections from now on; for any thread."""
        with contextlib.suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Stop listening, finish answers that are under way, and end all connections."""
        self.stop_listening()
        self.server_close()
        with self._changed:
            for client in self._open:
                self._end(client, socket.SHUT_RD)
            self._changed.wait_for(lambda: not self._open, _CLOSE_TIMEOUT)

    def get_request(self) -> tuple[socket.socket, Any]:
        """Accept a connection; without a free descriptor, pause instead of spinning."""
        try:
            client, address = self.socket.accept()
        except OSError as error:
            if self.socket.fileno() >= 0 and not isinstance(error, BlockingIOError):
                time.sleep(_ACCEPT_PAUSE)
            raise
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET_ON_CLOSE)
        return client, address

    def process_request(self, request: Any, client_address: Any) -> None:
        """Start a thread for the connection, if need be in place of the oldest connection."""
        if not self._free.acquire(blocking=False):
            self.resets += 1
            with self._changed:
                oldest = next((client for client, ending in self._open.items() if not ending), None)
                if oldest is not None:
                    self._end(oldest, socket.SHUT_RDWR)
            if not self._free.acquire(timeout=_CLOSE_TIMEOUT):
                request.close()
                return
        with self._changed:
            self._open[request] = False
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Wait until the client has closed its side, and close ours; else reset it."""
        with contextlib.suppress(OSError):
            request.settimeout(CLIENT_TIMEOUT)
            while request.recv(LARGEST_BODY):
                pass
            if self._open.get(request) is False:
                request.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _CLOSE_IN_ORDER)
        request.close()
        with self._changed:
            if self._open.pop(request, None) is not None:
                self._free.release()
            self._changed.notify_all()

    def _end(self, client: socket.socket, how: int) -> None:
        """Wake the thread of a connection, which resets it."""
        self._open[client] = True
        with contextlib.suppress(OSError):
            client.shutdown(how)

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ARG002
        """Log a defect of the daemon; clients that disconnect are ignored."""
        if not isinstance(sys.exc_info()[1], OSError):
            _log.exception("%s: a connection was reset by a defect of the daemon", client_address)


class _Handler(http.server.BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"
    timeout = CLIENT_TIMEOUT
    disable_nagle_algorithm = True

    def do_POST(self) -> None:
        status = self._rejection()
        body = None if status else self.rfile.read(int(self.headers["Content-Length"]))
        if body is not None and len(body) < int(self.headers["Content-Length"]):
            self.close_connection = True
            return
        if body is not None and self._encoding() == "gzip":
            body, status = _unpacked(body)
        if body is None:
            self.send_error(status)
            return
        reply = self.server.answer(body)
        self.server.requests += 1
        ending = "Connection: close\r\n\r\n" if self.close_connection else "\r\n"
        head = (
            f"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nContent-Length: {len(reply)}\r\n{ending}"
        )
        self.wfile.write(head.encode("ascii") + reply)

    def _rejection(self) -> int:
        """Return the status of a request that is refused by its head; 0 for any other."""
        headers = self.headers
        # Only browsers send an origin: a page of the web may neither ask nor end the daemon, nor
        # may one whose host name was made to point to this machine.
        hosts = headers.get_all("Host", ["localhost"])
        if "Origin" in headers or not all(_OUR_HOST.fullmatch(host.strip()) for host in hosts):
            return 403
        if self.path != PATH:
            return 404
        if "Transfer-Encoding" in headers or self._encoding() not in {"identity", "gzip"}:
            return 501
        lengths = {length.strip() for length in headers.get_all("Content-Length", [])}
        if len(lengths) != 1:
            return 400 if lengths else 411
        (length,) = lengths
        if not _LENGTH.fullmatch(length):
            return 400
        return 413 if int(length) > LARGEST_BODY else 0

    def _encoding(self) -> str:
        return str(self.headers.get("Content-Encoding", "identity")).lower()

    def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002 - the library's name
        """Log nothing: there are thousands of requests."""


def _unpacked(packed: bytes) -> tuple[bytes | None, int]:
    """Unpack gzip; None with a status when it is broken or unpacks to too much."""
    unpacker = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
    try:
        body = unpacker.decompress(packed, LARGEST_BODY + 1)
    except zlib.error:
        return None, 400
    if not unpacker.eof or len(body) > LARGEST_BODY:
        return None, 400
    return body, 0
