"""A thin client of the graph daemon, ours or ros2cli's own: no rclpy, up at once.

One call a connection, each with a deadline for the whole of it. A connection that is reset before
the answer is tried again until that deadline: ros2cli's daemon has a short queue and resets what
does not fit, and questions about the graph may be asked twice.
"""

from __future__ import annotations

import socket
import time
from typing import TYPE_CHECKING, Final, NamedTuple

from play_launch.graph_daemon.client.reply import Fault, ReplyFormatError, Value, read_reply

if TYPE_CHECKING:
    from play_launch.graph_daemon.contract import DaemonAddress

DEFAULT_TIMEOUT: Final = 10.0
"""Seconds for one call; a daemon that is just being started answers within its warm-up of 5 s."""
LARGEST_REPLY: Final = 64 * 1024 * 1024
"""Bytes; 10,000 topics with long names take a hundredth of it."""

_CHUNK: Final = 256 * 1024
_FIRST_PAUSE: Final = 0.01
_LONGEST_PAUSE: Final = 0.2


class DaemonError(Exception):
    """A call to the daemon did not come to an answer; the text says why, for a person."""


class NoDaemonError(DaemonError):
    """Nobody listens at the daemon's address."""

    def __init__(self, address: DaemonAddress) -> None:
        super().__init__(f"no daemon runs for ROS domain {address.domain} ({_place(address)})")


class DaemonTimeoutError(DaemonError):
    """Somebody listens, but has not answered in time."""

    def __init__(self, address: DaemonAddress, timeout: float) -> None:
        super().__init__(f"the daemon at {_place(address)} has not answered within {timeout:g} s")


class BadReplyError(DaemonError):
    """What came back is no answer of a graph daemon."""

    def __init__(self, address: DaemonAddress, what: str) -> None:
        super().__init__(
            f"what answers at {_place(address)} is no graph daemon, or a broken one: {what}"
        )


class RemoteError(DaemonError):
    """The daemon reports that the call failed there."""

    def __init__(self, method: str, fault: Fault) -> None:
        super().__init__(f"the daemon could not answer {method}: {fault.text}")
        self.text = fault.text


class NodeName(NamedTuple):
    """A node as the graph has it; two nodes may bear the same name."""

    name: str
    namespace: str

    @property
    def full_name(self) -> str:
        """The namespace and the name, with one slash between."""
        return f"{self.namespace.removesuffix('/')}/{self.name}"


class Named(NamedTuple):
    """A topic, service or action: its full name and its types, mostly one."""

    name: str
    types: tuple[str, ...]


class GraphClient:
    """Asks the daemon at ``address``; ``timeout`` is the limit of each call in seconds.

    Every method raises a ``DaemonError`` of one of the kinds above.
    """

    def __init__(self, address: DaemonAddress, timeout: float = DEFAULT_TIMEOUT) -> None:
        self._address = address
        self._timeout = timeout

    def nodes(self) -> list[NodeName]:
        """All nodes, hidden ones too, sorted by their full names."""
        method = "get_node_names_and_namespaces"
        found = []
        for row in self._rows(method, self.call(method)):
            # An enclave may follow.
            if len(row) < 2 or not isinstance(row[0], str) or not isinstance(row[1], str):
                raise self._odd(method)
            found.append(NodeName(row[0], row[1]))
        return sorted(found, key=lambda node: node.full_name)

    def names_and_types(self, method: str, *arguments: str) -> list[Named]:
        """What a method answers whose name ends in ``names_and_types`` or in ``…_by_node``.

        ``arguments`` are none, or a node's name and namespace. Sorted by name.
        """
        found = []
        for row in self._rows(method, self.call(method, *arguments)):
            if len(row) != 2:
                raise self._odd(method)
            name, types = row
            if not isinstance(name, str) or not isinstance(types, list):
                raise self._odd(method)
            found.append(Named(name, tuple(map(str, types))))
        return sorted(found)

    def call(self, method: str, *arguments: str) -> Value:
        """Call a method that may be called twice, and return its answer."""
        request = _request(self._address, method, arguments)
        deadline = time.monotonic() + self._timeout
        pause = _FIRST_PAUSE
        while True:
            try:
                reply = self._exchange(request, deadline)
                return read_reply(_body(reply))
            except ConnectionRefusedError:
                raise NoDaemonError(self._address) from None
            except TimeoutError:
                raise DaemonTimeoutError(self._address, self._timeout) from None
            except (ConnectionResetError, BrokenPipeError):
                if time.monotonic() + pause > deadline:
                    raise DaemonTimeoutError(self._address, self._timeout) from None
                time.sleep(pause)
                pause = min(2 * pause, _LONGEST_PAUSE)
            except OSError as error:
                raise DaemonError(f"{_place(self._address)}: {error.strerror or error}") from None
            except Fault as fault:
                raise RemoteError(method, fault) from None
            except ReplyFormatError as error:
                raise BadReplyError(self._address, str(error)) from None

    def _exchange(self, request: bytes, deadline: float) -> bytes:
        where = (self._address.host, self._address.port)
        with socket.create_connection(where, timeout=_left(deadline)) as connection:
            connection.sendall(request)
            reply = bytearray()
            wanted = LARGEST_REPLY
            while len(reply) < wanted:
                connection.settimeout(_left(deadline))
                chunk = connection.recv(_CHUNK)
                if not chunk:
                    break
                reply += chunk
                if wanted == LARGEST_REPLY:
                    wanted = _whole_length(reply)
        if not reply:
            # Closed without a word: what a full queue and a dying daemon do.
            raise ConnectionResetError
        if len(reply) < wanted < LARGEST_REPLY:
            raise ReplyFormatError(f"the reply ends after {len(reply)} of {wanted} bytes")
        if len(reply) >= LARGEST_REPLY:
            raise ReplyFormatError(f"the reply is larger than {LARGEST_REPLY >> 20} MiB")
        return bytes(reply)

    def _rows(self, method: str, value: Value) -> list[list[Value]]:
        if not isinstance(value, list):
            raise self._odd(method)
        rows = [row for row in value if isinstance(row, list)]
        if len(rows) != len(value):
            raise self._odd(method)
        return rows

    def _odd(self, method: str) -> BadReplyError:
        return BadReplyError(self._address, f"the answer to {method} has an unknown form")


def _request(address: DaemonAddress, method: str, arguments: tuple[str, ...]) -> bytes:
    values = "".join(
        f"<param><value><string>{_escaped(value)}</string></value></param>" for value in arguments
    )
    body = (
        f"<?xml version='1.0'?><methodCall><methodName>{_escaped(method)}</methodName>"
        f"<params>{values}</params></methodCall>"
    ).encode("utf-8", "replace")
    head = (
        f"POST {address.path} HTTP/1.0\r\nHost: {_place(address)}\r\n"
        f"Content-Type: text/xml\r\nContent-Length: {len(body)}\r\n\r\n"
    )
    return head.encode("ascii") + body


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def _left(deadline: float) -> float:
    left = deadline - time.monotonic()
    if left <= 0:
        raise TimeoutError
    return left


def _whole_length(reply: bytearray) -> int:
    """Say how long a reply will be, head and all; the largest while its head is not complete."""
    end = reply.find(b"\r\n\r\n")
    if end < 0:
        return LARGEST_REPLY
    for line in bytes(reply[:end]).split(b"\r\n")[1:]:
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"content-length":
            digits = value.strip()
            if not digits.isdigit() or len(digits) > 12:
                raise ReplyFormatError("a Content-Length that is no number")
            return min(end + 4 + int(digits), LARGEST_REPLY)
    return LARGEST_REPLY


def _body(reply: bytes) -> bytes:
    head, separator, body = reply.partition(b"\r\n\r\n")
    words = head.split(b"\r\n", 1)[0].split(b" ", 2)
    if not separator or not words[0].startswith(b"HTTP/") or len(words) < 2:
        raise ReplyFormatError("it does not speak HTTP")
    if words[1] != b"200":
        raise ReplyFormatError(f"HTTP status {words[1][:20].decode('ascii', 'replace')}")
    return body


def _place(address: DaemonAddress) -> str:
    return f"{address.host}:{address.port}"
