"""Clients of a daemon: many at once, each with a connection of its own for each call."""

from __future__ import annotations

import errno
import http.client
import select
import socket
import statistics
import time
import xmlrpc.client
from dataclasses import dataclass, field
from typing import Any

from play_launch.graph_daemon.contract import DaemonAddress

_CHUNK = 1 << 20


def request(method: str) -> bytes:
    body = xmlrpc.client.dumps((), method).encode()
    head = (
        "POST /ros2cli/ HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n"
        f"Content-Type: text/xml\r\nContent-Length: {len(body)}\r\n\r\n"
    )
    return head.encode() + body


TOPICS = request("get_topic_names_and_types")
NODES = request("get_node_names_and_namespaces")


@dataclass
class Result:
    """Latencies and failures of some calls."""

    latencies: list[float] = field(default_factory=list)
    """Seconds of each call that was answered."""
    failures: int = 0
    """Calls that were reset, refused or not answered in time."""
    seconds: float = 0.0

    @property
    def rate(self) -> float:
        return len(self.latencies) / self.seconds if self.seconds else 0.0

    @property
    def median(self) -> float:
        return statistics.median(self.latencies) if self.latencies else float("inf")

    def quantile(self, part: float) -> float:
        if not self.latencies:
            return float("inf")
        return sorted(self.latencies)[min(len(self.latencies) - 1, int(part * len(self.latencies)))]


class _Call:
    """One connection; driven by epoll."""

    def __init__(self, address: DaemonAddress, data: bytes) -> None:
        self.began = time.monotonic()
        self._data = data
        self._answer = bytearray()
        self._wanted = -1
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self.socket.setblocking(False)
        code = self.socket.connect_ex((address.host, address.port))
        if code not in {0, errno.EINPROGRESS}:
            raise OSError(code, "refused")

    def advance(self, events: int) -> bool:
        """Go on; whether the answer is complete. Raises OSError when it never will be."""
        if events & select.EPOLLOUT and self._data:
            sent = self.socket.send(self._data)
            self._data = self._data[sent:]
        if events & (select.EPOLLIN | select.EPOLLHUP | select.EPOLLERR):
            chunk = self.socket.recv(_CHUNK)
            if not chunk:
                raise OSError(errno.ECONNRESET, "closed without an answer")
            self._answer += chunk
            if self._wanted < 0:
                end = self._answer.find(b"\r\n\r\n")
                if end >= 0:
                    head = bytes(self._answer[:end]).lower()
                    self._wanted = end + 4 + int(head.partition(b"content-length:")[2].split()[0])
        return 0 <= self._wanted <= len(self._answer)

    @property
    def interest(self) -> int:
        return select.EPOLLOUT if self._data else select.EPOLLIN


def call_all(
    address: DaemonAddress,
    data: bytes,
    *,
    at_once: int,
    calls: int = 0,
    seconds: float = 0.0,
    limit: float = 10.0,
) -> Result:
    """Make calls, ``at_once`` at a time, until there were ``calls`` or ``seconds`` are over."""
    result = Result()
    poll = select.epoll()
    running: dict[int, _Call] = {}
    started = 0
    begin = time.monotonic()

    def wants_more() -> bool:
        if calls:
            return started < calls
        return time.monotonic() - begin < seconds

    while True:
        while len(running) < at_once and wants_more():
            started += 1
            try:
                new = _Call(address, data)
            except OSError:
                result.failures += 1
                continue
            running[new.socket.fileno()] = new
            poll.register(new.socket, new.interest)
        if not running:
            break
        for number, events in poll.poll(0.1):
            call = running[number]
            try:
                done = call.advance(events)
            except OSError:
                result.failures += 1
                done = True
            else:
                if done:
                    result.latencies.append(time.monotonic() - call.began)
                else:
                    poll.modify(number, call.interest)
            if done:
                poll.unregister(number)
                del running[number]
                call.socket.close()
        now = time.monotonic()
        for number, call in list(running.items()):
            if now - call.began > limit:
                result.failures += 1
                poll.unregister(number)
                del running[number]
                call.socket.close()
    poll.close()
    result.seconds = time.monotonic() - begin
    return result


def bursts(
    address: DaemonAddress, data: bytes, *, clients: int, rounds: int, limit: float = 10.0
) -> Result:
    """Let ``clients`` come at the same moment, again and again."""
    result = Result()
    for _ in range(rounds):
        one = call_all(address, data, at_once=clients, calls=clients, limit=limit)
        result.latencies += one.latencies
        result.failures += one.failures
        result.seconds += one.seconds
    return result


def nodes(address: DaemonAddress, limit: float = 10.0) -> set[str]:
    """The names of the nodes; raises OSError as sockets do."""
    transport = _Transport(limit)
    with xmlrpc.client.ServerProxy(address.url, transport=transport, allow_none=True) as proxy:
        try:
            found: Any = proxy.get_node_names_and_namespaces()
        except (http.client.HTTPException, xmlrpc.client.Error) as error:
            raise OSError(errno.EIO, str(error)) from None
    return {name for name, _ in found}


class _Transport(xmlrpc.client.Transport):
    def __init__(self, limit: float) -> None:
        super().__init__()
        self._limit = limit

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = self._limit
        return connection
