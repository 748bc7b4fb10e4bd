"""Blocking client of a running session; imports next to nothing, so that commands are quick."""

from __future__ import annotations

import os
import select
import socket
import sys
import time
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

from play_launch.control.protocol import (
    ANSWER_LIMIT,
    COMMAND_LIMIT,
    PROTOCOL,
    REQUEST_LIMIT,
    Code,
    OperationError,
    decode,
    encode,
)
from play_launch.control.registration import address_of, peer_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.control.registration import Peer

TIMEOUT: Final = 10.0
"""Seconds for an answer that needs no work."""
_PIECE: Final = 256 * 1024
"""Bytes that are read at once."""


class SessionInfo(NamedTuple):
    """First message of a session."""

    pid: int
    name: str
    """Of its configuration."""
    session: str
    folder: str
    version: str
    """Of play-launch."""
    started_ns: int
    """Nanoseconds since the epoch."""
    machine: str
    """The one of the machines whose part it runs; empty: the whole system."""


class ControlClient:
    """A connection to one session."""

    def __init__(self, folder: str, timeout: float = TIMEOUT) -> None:
        """Connect to the session in a folder and read its hello.

        Raises OSError when the connection fails, TimeoutError included, and OperationError when
        something else listens, or the session refuses.
        """
        deadline = time.monotonic() + timeout
        self._connection = socket.socket(socket.AF_UNIX)
        self._lines: list[bytes] = []
        self._rest = bytearray()
        self._numbers = count(1)
        try:
            with address_of(folder) as address:
                _connect(self._connection, address, deadline)
            listener = self.peer().uid
            if os.geteuid() not in {0, listener} and listener != 0:
                raise PermissionError(None, f"it belongs to user {listener}")  # noqa: TRY301
            self._fill(deadline)
            self.hello = _hello(decode(self._lines.pop(0)))
        except BaseException:
            self._connection.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._connection.close()

    def fileno(self) -> int:
        """Descriptor that is readable when messages have arrived."""
        return self._connection.fileno()

    def peer(self) -> Peer:
        return peer_of(self._connection)

    def ask(
        self,
        operation: str,
        arguments: dict[str, Any] | None = None,
        *,
        limit: float = TIMEOUT,
    ) -> Any:
        """Request an operation of docs/control.md and return its result.

        Raises OperationError when the session refuses, or does not answer within ``limit`` seconds.
        """
        for message in self.stream(operation, arguments, limit=limit):
            if "result" in message:
                return message["result"]
        raise OperationError(Code.INTERNAL, "the session ended without an answer")

    def stream(
        self,
        operation: str,
        arguments: dict[str, Any] | None = None,
        *,
        limit: float | None = None,
    ) -> Iterator[dict[str, Any]]:
        """Yield the messages that answer a request, up to the one with its result.

        When the session ends, there is no result. ``limit`` is in seconds, for all of it.

        Raises OperationError when the session refuses, or at the time limit.
        """
        deadline = None if limit is None else time.monotonic() + limit
        number = self.request(operation, arguments, limit=TIMEOUT)
        while True:
            try:
                self._fill(deadline)
            except TimeoutError:
                text = f"{self.hello.name} (pid {self.hello.pid}) did not answer in time"
                raise OperationError(Code.TIMEOUT, text) from None
            except EOFError:
                return
            message = decode(self._lines.pop(0))
            if message.get("id") not in {number, None}:
                continue
            if "error" in message:
                raise OperationError.of(message["error"])
            yield message
            if "result" in message:
                return

    def request(
        self, operation: str, arguments: dict[str, Any] | None = None, *, limit: float = 0.0
    ) -> int:
        """Send a request and return its number; `arrived` returns the answers.

        Raises OperationError when the session does not read it within ``limit`` seconds.
        """
        number = next(self._numbers)
        line = encode(
            {
                "id": number,
                "op": operation,
                "protocol": PROTOCOL,
                "arguments": arguments or {},
                "command": own_command(),
            }
        )
        if len(line) > REQUEST_LIMIT + 1:
            text = f"a request of {len(line)} bytes; the limit is {REQUEST_LIMIT}"
            raise OperationError(Code.TOO_LONG, text)
        self._connection.settimeout(limit)
        try:
            self._connection.sendall(line)
        except (BlockingIOError, TimeoutError):
            # A part of the request may be sent, and nothing can follow it.
            self._connection.shutdown(socket.SHUT_RDWR)
            text = f"{self.hello.name} (pid {self.hello.pid}) does not read requests"
            raise OperationError(Code.TIMEOUT, text) from None
        except OSError as error:
            text = f"the connection was closed: {error.strerror or error}"
            raise OperationError(Code.INTERNAL, text) from None
        return number

    def arrived(self) -> list[dict[str, Any]]:
        """Return the messages that have arrived, of all requests, without waiting.

        Raises EOFError when the session has ended, or the connection, and OperationError when a
        message is malformed.
        """
        try:
            self._fill(0.0)
        except TimeoutError:
            return []
        lines, self._lines = self._lines, []
        return [decode(line) for line in lines]

    def _fill(self, deadline: float | None) -> None:
        """Read until there is a line; raises EOFError, TimeoutError, OperationError."""
        while not self._lines:
            left = None if deadline is None else max(deadline - time.monotonic(), 0.0) * 1e3
            poll = select.poll()
            poll.register(self._connection, select.POLLIN)
            if not poll.poll(left):
                raise TimeoutError
            try:
                data = self._connection.recv(_PIECE)
            except OSError as error:
                raise EOFError(str(error)) from None
            if not data:
                raise EOFError
            self._rest += data
            if len(self._rest) > ANSWER_LIMIT + _PIECE:
                raise OperationError(Code.TOO_LONG, f"a line is longer than {ANSWER_LIMIT} bytes")
            if b"\n" in data:
                *self._lines, rest = bytes(self._rest).split(b"\n")
                self._rest = bytearray(rest)


def own_command() -> tuple[str, ...]:
    """Return the command line of this process, for the record of its actions."""
    program, *words = sys.argv
    command, left = [], COMMAND_LIMIT
    for word in (Path(program).name, *words):
        command.append(word[:left])
        left -= len(word)
        if left <= 0:
            break
    return tuple(command)


def _connect(connection: socket.socket, address: str, deadline: float) -> None:
    connection.setblocking(False)
    while True:
        try:
            return connection.connect(address)
        except BlockingIOError:  # its queue of connections is full
            if time.monotonic() > deadline:
                raise TimeoutError from None
            time.sleep(0.01)


def _hello(message: dict[str, Any]) -> SessionInfo:
    if "error" in message:
        raise OperationError.of(message["error"])
    found = message.get("hello")
    if not isinstance(found, dict):
        raise OperationError(Code.PROTOCOL, "not a session of play-launch")
    if found.get("protocol") != PROTOCOL:
        raise OperationError(
            Code.PROTOCOL,
            f"play-launch {found.get('version')} uses protocol {found.get('protocol')} and this "
            f"command {PROTOCOL}; use the command of the session's version",
        )
    try:
        values = {"machine": "", **found}  # version 0.1.0 sends none
        return SessionInfo(**{name: values[name] for name in SessionInfo._fields})
    except KeyError as error:
        raise OperationError(Code.PROTOCOL, f"the hello lacks {error}") from None
