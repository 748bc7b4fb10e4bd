"""Talks to a running session; blocks. Imports nothing that takes time: commands are to be quick."""

from __future__ import annotations

import os
import socket
import sys
import time
from itertools import count
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

from play_launch.control.place import peer_of
from play_launch.control.protocol import (
    LONGEST_ANSWER,
    LONGEST_COMMAND,
    PROTOCOL,
    Code,
    ControlError,
    LineSplitter,
    Request,
    decode,
    request_line,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.control.place import Peer

ANSWER_LIMIT: Final = 10.0
"""Seconds for an answer that needs no work; a supervisor that is stopped answers never."""

_AT_ONCE: Final = 256 * 1024
"""Bytes that are read at once."""


class Hello(NamedTuple):
    """What a session says about itself."""

    pid: int
    name: str
    """As its configuration calls it."""
    session: str
    folder: str
    version: str
    """Of play-launch."""
    started_ns: int
    """Nanoseconds since the epoch."""


class ControlClient:
    """A connection to one session."""

    def __init__(self, connection: socket.socket, hello: Hello) -> None:
        """Take a connection on which the session has greeted."""
        self.hello = hello
        self._connection = connection
        self._lines: list[bytes] = []
        self._splitter = LineSplitter(LONGEST_ANSWER)
        self._numbers = count(1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the connection, and with it what streams."""
        self._connection.close()

    def fileno(self) -> int:
        """The descriptor: readable when something was said."""
        return self._connection.fileno()

    def peer(self) -> Peer:
        """Tell the user and process that listen at the other end, as the kernel says."""
        return peer_of(self._connection)

    def ask(
        self,
        operation: str,
        arguments: dict[str, Any] | None = None,
        *,
        limit: float = ANSWER_LIMIT,
    ) -> Any:
        """Have something done and return the result.

        Args:
            operation: As docs/control.md names it.
            arguments: What it takes.
            limit: Seconds to wait for the answer.

        Raises:
            ControlError: When the session refuses, or does not answer in time.
        """
        for message in self.stream(operation, arguments, limit=limit):
            if "result" in message:
                return message["result"]
        raise ControlError(Code.INTERNAL, "the session ended without an answer")

    def stream(
        self,
        operation: str,
        arguments: dict[str, Any] | None = None,
        *,
        limit: float | None = None,
    ) -> Iterator[dict[str, Any]]:
        """Yield the messages that answer a request, up to the one with its result.

        The end of the session ends it without a result. ``limit`` is in seconds, for all of it.

        Raises:
            ControlError: When the session refuses, or the time is over.
        """
        number = next(self._numbers)
        line = request_line(Request(number, operation, arguments or {}, own_command()))
        deadline = None if limit is None else time.monotonic() + limit
        try:
            self._connection.settimeout(ANSWER_LIMIT)
            self._connection.sendall(line)
            while True:
                left = None if deadline is None else max(deadline - time.monotonic(), 0.001)
                self._connection.settimeout(left)
                message = self._read()
                if message.get("id") not in {number, None}:
                    continue
                if "error" in message:
                    raise ControlError.of(message["error"])
                yield message
                if "result" in message:
                    return
        except TimeoutError:
            raise ControlError(Code.TIMEOUT, f"{self._named()} did not answer in time") from None
        except EOFError:
            return
        except OSError as error:
            raise _broken(error) from None

    def request(self, operation: str, arguments: dict[str, Any] | None = None) -> int:
        """Ask without waiting for the answer, which `arrived` gives; return its number.

        From the first use of this or of `arrived` on, `ask` and `stream` are not for this client.

        Raises:
            ControlError: When the session takes no more, because it reads nothing.
        """
        number = next(self._numbers)
        line = request_line(Request(number, operation, arguments or {}, own_command()))
        self._connection.setblocking(False)
        try:
            sent = self._connection.send(line)
        except BlockingIOError:
            raise ControlError(Code.TIMEOUT, f"{self._named()} reads nothing") from None
        except OSError as error:
            raise _broken(error) from None
        if sent < len(line):
            # Half a request cannot be taken back, and nothing can follow it.
            self._connection.shutdown(socket.SHUT_RDWR)
            raise ControlError(Code.TIMEOUT, f"{self._named()} reads nothing")
        return number

    def arrived(self) -> list[dict[str, Any]]:
        """Return the messages that have arrived, of all requests, without waiting.

        Raises:
            EOFError: When the session has ended, or the connection.
            ControlError: When it says what is no protocol.
        """
        self._connection.setblocking(False)
        lines, self._lines = self._lines[::-1], []
        try:
            data = self._connection.recv(_AT_ONCE)
        except BlockingIOError:
            data = None
        except OSError as error:
            raise EOFError(str(error)) from None
        if data:
            lines += self._splitter.feed(data)
        elif data is not None and not lines:
            raise EOFError
        return [decode(line) for line in lines]

    def _named(self) -> str:
        return f"{self.hello.name} (pid {self.hello.pid})"

    def _read(self) -> dict[str, Any]:
        while not self._lines:
            data = self._connection.recv(_AT_ONCE)
            if not data:
                raise EOFError
            self._lines = self._splitter.feed(data)
            self._lines.reverse()
        return decode(self._lines.pop())


def own_command() -> tuple[str, ...]:
    """Give the command line of this process, for the record of what it asks for."""
    program, *words = sys.argv
    command, left = [], LONGEST_COMMAND
    for word in (os.path.basename(program), *words):  # noqa: PTH119 - pathlib is slow to import
        command.append(word[:left])
        left -= len(word)
        if left <= 0:
            break
    return tuple(command)


def _broken(error: OSError) -> ControlError:
    return ControlError(Code.INTERNAL, f"the connection ended: {error.strerror or error}")


def hello_of(message: dict[str, Any]) -> Hello:
    """Read a greeting; raises ControlError."""
    if "error" in message:
        raise ControlError.of(message["error"])
    found = message.get("hello")
    if not isinstance(found, dict):
        raise ControlError(Code.PROTOCOL, "what listens there is no session of play-launch")
    if found.get("protocol") != PROTOCOL:
        raise ControlError(
            Code.PROTOCOL,
            f"play-launch {found.get('version')} speaks protocol {found.get('protocol')} and this "
            f"command {PROTOCOL}; use the command of the version that runs",
        )
    try:
        return Hello(
            pid=int(found["pid"]),
            name=str(found["name"]),
            session=str(found["session"]),
            folder=str(found["folder"]),
            version=str(found["version"]),
            started_ns=int(found["started_ns"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ControlError(Code.PROTOCOL, f"a greeting without {error}") from None
