"""A thin client of the graph daemon without rclpy and XML: its answers are JSON in one string.

One call a connection, each with a deadline for the whole of it. A connection that is reset before
the answer is tried again until that deadline, since ros2cli's daemon has a short queue and resets
what does not fit.
"""

from __future__ import annotations

import json
import re
import socket
import struct
import time
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from play_launch import UserError
from play_launch.graph_daemon.contract import ENDPOINTS_METHOD, JSON_METHOD, UNSERVED_METHOD

if TYPE_CHECKING:
    from play_launch.graph_daemon.contract import DaemonAddress
    from play_launch.supervisor.endpoints import Endpoint

DEFAULT_TIMEOUT: Final = 10.0
"""Seconds for one call; a daemon that is just being started answers within its warm-up of 5 s."""
LARGEST_REPLY: Final = 64 * 1024 * 1024
"""Bytes; 10,000 topics with long names take a hundredth of it."""

_CHUNK: Final = 256 * 1024
_TEXT: Final = re.compile(rb"<string>(.*?)</string>", re.DOTALL)
_LENGTH: Final = re.compile(rb"\r\ncontent-length:[ \t]*([0-9]{1,12})[ \t]*\r\n", re.IGNORECASE)
_RESET_ON_CLOSE: Final = struct.pack("ii", 1, 0)
_FIRST_PAUSE: Final = 0.01
_LONGEST_PAUSE: Final = 0.2


class DaemonError(UserError):
    """A call to the daemon failed; the text is a message for the user."""

    exit_code = 1


class NoDaemonError(DaemonError):
    """No process listens at the daemon's address."""

    def __init__(self, address: DaemonAddress) -> None:
        super().__init__(f"no daemon runs for ROS domain {address.domain} ({_place(address)})")


class BadReplyError(DaemonError):
    """The answer is not that of a graph daemon."""

    def __init__(self, address: DaemonAddress, what: str) -> None:
        super().__init__(f"the process at {_place(address)} is no graph daemon: {what}")


class RemoteError(DaemonError):
    """The daemon answered with a fault; ros2cli's does to methods that only ours has."""

    def __init__(self, method: str, text: str, domain: int) -> None:
        super().__init__(
            f"ros2cli's daemon serves ROS domain {domain}; replace it with "
            "'play-launch daemon start'"
            if f'"{method}" is not supported' in text
            else f"the daemon could not answer {method}: {text}"
        )
        self.text = text


class NodeName(NamedTuple):
    """A node as the graph has it; two nodes may have the same name."""

    name: str
    namespace: str

    @property
    def full_name(self) -> str:
        return f"{self.namespace.removesuffix('/')}/{self.name}"

    @property
    def is_hidden(self) -> bool:
        return not self.name or self.name.startswith("_")


class Named(NamedTuple):
    """A topic, service or action: its full name and its types, mostly one."""

    name: str
    types: tuple[str, ...]


class GraphClient:
    """Queries the daemon at ``address``; ``timeout`` is the limit of each call in seconds.

    Every method raises a ``DaemonError`` of one of the kinds above.
    """

    def __init__(self, address: DaemonAddress, timeout: float = DEFAULT_TIMEOUT) -> None:
        self._address = address
        self._timeout = timeout

    def nodes(self) -> list[NodeName]:
        rows = self._query("get_node_names_and_namespaces")
        return sorted((NodeName(*row[:2]) for row in rows), key=lambda node: node.full_name)

    def names_and_types(self, method: str, *arguments: str) -> list[Named]:
        """Call a method whose name ends in ``names_and_types`` or in ``…_by_node``.

        ``arguments`` are none, or a node's name and namespace. Sorted by name.
        """
        return sorted(Named(name, tuple(types)) for name, types in self._query(method, *arguments))

    def endpoints(self) -> list[Endpoint]:
        """Give all publishers and subscriptions; a ``RemoteError`` where the daemon is older."""
        from play_launch.supervisor.endpoints import Endpoint  # noqa: PLC0415 - msgspec is slow

        return [Endpoint(*row) for row in self._query(ENDPOINTS_METHOD)]

    def unserved_services(self) -> list[Named]:
        """Give the services that have clients and no server, in the same way."""
        return self.names_and_types(UNSERVED_METHOD)

    def call(self, method: str, *arguments: str) -> str:
        """Call a method that may be called twice, and return its text; empty for any other value.

        The methods that the client uses answer with a text or with nothing.
        """
        request = _request(self._address, method, arguments)
        deadline = time.monotonic() + self._timeout
        pause = _FIRST_PAUSE
        while True:
            try:
                return self._text(method, self._exchange(request, deadline))
            except ConnectionRefusedError:
                raise NoDaemonError(self._address) from None
            except (TimeoutError, ConnectionResetError, BrokenPipeError):
                if time.monotonic() + pause > deadline:
                    raise DaemonError(
                        f"the daemon at {_place(self._address)} did not answer within "
                        f"{self._timeout:g} s"
                    ) from None
                time.sleep(pause)
                pause = min(2 * pause, _LONGEST_PAUSE)
            except OSError as error:
                raise DaemonError(f"{_place(self._address)}: {error.strerror or error}") from None

    def _query(self, method: str, *arguments: str) -> list[Any]:
        text = self.call(JSON_METHOD, method, *arguments)
        try:
            rows: list[Any] = json.loads(text)
            # A node has three texts with its enclave, anything else a name and a list of types.
            if not all(isinstance(row[0], str) and isinstance(row[1], str | list) for row in rows):
                raise TypeError  # noqa: TRY301 - handled with the others
        except (ValueError, TypeError, LookupError):
            message = f"its answer to {method} has an unknown form"
            raise BadReplyError(self._address, message) from None
        return rows

    def _exchange(self, request: bytes, deadline: float) -> bytes:
        """Return head and body of the reply, without what may be missing at its end."""
        place = (self._address.host, self._address.port)
        with socket.create_connection(place, timeout=_left(deadline)) as connection:
            connection.sendall(request)
            reply = bytearray()
            wanted = LARGEST_REPLY
            while len(reply) < wanted:
                connection.settimeout(_left(deadline))
                chunk = connection.recv(_CHUNK)
                if not chunk:
                    # ros2cli's daemon closes first: a reset leaves no TIME_WAIT at its port.
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET_ON_CLOSE)
                    break
                reply += chunk
                if wanted == LARGEST_REPLY and (end := reply.find(b"\r\n\r\n")) >= 0:
                    length = _LENGTH.search(reply, 0, end + 2)
                    wanted = min(end + 4 + int(length[1]), LARGEST_REPLY) if length else wanted
        if not reply:
            # Closed without an answer: as a full queue and an ending daemon do.
            raise ConnectionResetError
        return bytes(reply)

    def _text(self, method: str, reply: bytes) -> str:
        head, _, body = reply.partition(b"\r\n\r\n")
        words = head.split(b"\r\n", 1)[0].split(b" ", 2)
        if len(words) < 2 or not words[0].startswith(b"HTTP/"):
            raise BadReplyError(self._address, "it does not speak HTTP")
        if words[1] != b"200":
            status = words[1][:20].decode("ascii", "replace")
            raise BadReplyError(self._address, f"HTTP status {status}")
        if not body.rstrip().endswith(b"</methodResponse>"):
            raise BadReplyError(self._address, "its answer is no XML-RPC, or is cut off")
        found = _TEXT.search(body)
        text = _unescaped(found[1].decode("utf-8", "replace")) if found else ""
        if b"<fault>" in body[:200]:
            raise RemoteError(method, text, self._address.domain)
        return text


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


def _unescaped(text: str) -> str:
    return text.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")


def _left(deadline: float) -> float:
    left = deadline - time.monotonic()
    if left <= 0:
        raise TimeoutError
    return left


def _place(address: DaemonAddress) -> str:
    return f"{address.host}:{address.port}"
