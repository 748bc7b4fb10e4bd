"""A daemon whose answers a test decides."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from xmlrpc.client import Fault, dumps, loads

from play_launch.graph_daemon.contract import HOST, JSON_METHOD, DaemonAddress

LIMIT = 60.0


class ScriptedDaemon:
    """Serves one connection after the other; ``behave`` gets each with its request."""

    def __init__(self, behave: Callable[[socket.socket, bytes], None]) -> None:
        self._behave = behave
        self.requests: list[bytes] = []
        self._listener = socket.create_server((HOST, 0))
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def address(self) -> DaemonAddress:
        """Where it listens; a domain's own port may be taken by a real daemon."""
        return _At(self._listener.getsockname()[1])

    def close(self) -> None:
        # Wakes the accept.
        self._listener.shutdown(socket.SHUT_RDWR)
        self._thread.join(LIMIT)
        assert not self._thread.is_alive()
        self._listener.close()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            with connection:
                connection.settimeout(LIMIT)
                request = read_request(connection)
                self.requests.append(request)
                try:
                    self._behave(connection, request)
                except OSError:
                    continue


class _At(DaemonAddress):
    """An address with a port of its own."""

    def __init__(self, port: int) -> None:
        super().__init__(0)
        object.__setattr__(self, "_port", port)

    @property
    def port(self) -> int:
        port: int = self.__dict__["_port"]
        return port


@contextmanager
def scripted(behave: Callable[[socket.socket, bytes], None]) -> Iterator[ScriptedDaemon]:
    daemon = ScriptedDaemon(behave)
    try:
        yield daemon
    finally:
        daemon.close()


def read_request(connection: socket.socket) -> bytes:
    received = b""
    while b"</methodCall>" not in received:
        chunk = connection.recv(65536)
        if not chunk:
            break
        received += chunk
    return received


def asked(request: bytes) -> tuple[str, tuple[object, ...]]:
    """Return the method and its arguments."""
    arguments, method = loads(request.partition(b"\r\n\r\n")[2])
    return str(method), arguments


def reply(value: object, *, status: str = "200 OK", length: int | None = None) -> bytes:
    """Write a value, or a Fault, as the standard library's server does."""
    content: Any = value if isinstance(value, Fault) else (value,)
    body = dumps(content, methodresponse=True, allow_none=True).encode()
    return http(body, status=status, length=length)


def http(body: bytes, *, status: str = "200 OK", length: int | None = None) -> bytes:
    size = len(body) if length is None else length
    return f"HTTP/1.0 {status}\r\nContent-Length: {size}\r\n\r\n".encode() + body


def answering(answers: dict[str, object]) -> Callable[[socket.socket, bytes], None]:
    """Answer each method with its value; with a fault if it has none, as the real ones do."""

    def behave(connection: socket.socket, request: bytes) -> None:
        method, arguments = asked(request)
        if is_json := method == JSON_METHOD:
            method, *arguments = map(str, arguments)  # type: ignore[assignment]
        missing = Fault(1, f"<class 'Exception'>:method {method!r} is not supported")
        value = answers.get(method, missing)
        value = value(*arguments) if callable(value) else value
        is_text = is_json and not isinstance(value, Fault)
        connection.sendall(reply(json.dumps(value) if is_text else value))

    return behave
