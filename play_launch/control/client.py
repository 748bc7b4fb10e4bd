"""Talks to a running session; blocks. Imports nothing that takes time: commands are to be quick."""

from __future__ import annotations

import os
import socket
import time
from itertools import count
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

from play_launch.control.place import (
    CONTROL_SOCKET,
    Link,
    Registrant,
    address_of,
    forget,
    peer_of,
    registered,
    registrant_of,
)
from play_launch.control.protocol import (
    LONGEST_ANSWER,
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

ANSWER_LIMIT: Final = 10.0
"""Seconds for an answer that needs no work; a supervisor that is stopped answers never."""

_AT_ONCE: Final = 256 * 1024
"""Bytes that are read at once."""
_BUSY: Final = 0.01
"""Seconds between two tries where many connect."""


class NoSessionError(Exception):
    """There is no session to talk to, or it is not clear which one; the text names the fix."""


class AmbiguousSessionError(NoSessionError):
    """There are several; the text lists them."""


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

    def __init__(self, connection: socket.socket) -> None:
        """Read the greeting; raises ControlError, OSError. Closing is up to the caller then."""
        self._connection = connection
        self._lines: list[bytes] = []
        self._splitter = LineSplitter(LONGEST_ANSWER)
        self._numbers = count(1)
        connection.settimeout(ANSWER_LIMIT)
        self.hello = _hello(self._read())

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
        line = request_line(Request(number, operation, arguments or {}))
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
        line = request_line(Request(number, operation, arguments or {}))
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


def connect(session: str | None = None) -> ControlClient:
    """Connect to the running session, or to the one that is named.

    Args:
        session: Folder, pid or name of a session; None where only one runs.

    Raises:
        NoSessionError: When there is none, or more than one.
        ControlError: When it does not let us in.
    """
    if session is None:
        return _only_one()
    if os.path.isdir(session):  # noqa: PTH112 - pathlib is slow to import
        return connect_to(session)
    if session.isdecimal():
        pid = int(session)
        for link in registered():
            if link.pid == pid:
                return _registered_at(link)
    named: list[ControlClient] = []
    others: list[ControlClient] = []
    wanted = _in_utf8(session)
    for client in running():
        names = (client.hello.name, os.path.basename(client.hello.folder))  # noqa: PTH119
        is_it = wanted in {_in_utf8(name) for name in names}
        (named if is_it else others).append(client)
    for client in others:
        client.close()
    if len(named) == 1:
        return named[0]
    for client in named:
        client.close()
    known = _listed([client.hello for client in named or others])
    if named:
        raise AmbiguousSessionError(
            f"{len(named)} sessions are called {session}; name the folder or the pid:\n{known}"
        )
    raise NoSessionError(
        f"there is no session {session}: it is no folder, and no pid or name of a running session"
        + (f":\n{known}" if known else "; none is running")
    )


def _registered_at(link: Link) -> ControlClient:
    try:
        return connect_to(link.folder)
    except NoSessionError as error:
        raise NoSessionError(_without_session(link, error) or str(error)) from None


def _without_session(link: Link, error: NoSessionError) -> str:
    """Say what there is in place of a registered session; empty: nothing known or to be done."""
    match registrant_of(link):
        case Registrant.GONE:
            forget(link)
            return str(error)
        case Registrant.ALIVE:
            return (
                f"{error}; process {link.pid}, which registered it, still runs: its folder was "
                f"moved or removed; kill -INT {link.pid} ends it in order"
            )
    return ""


def connect_to(folder: str) -> ControlClient:
    """Connect to the session in a folder.

    Raises:
        NoSessionError: When none runs there, with what is left of one.
        ControlError: When it does not let us in.
    """
    connection = socket.socket(socket.AF_UNIX)
    connection.settimeout(ANSWER_LIMIT)
    client: ControlClient | None = None
    try:
        with address_of(folder) as address:
            _connect(connection, address)
        listening = peer_of(connection).uid
        if os.geteuid() == 0 or listening in {0, os.geteuid()}:
            client = ControlClient(connection)
    except (OSError, EOFError) as error:
        raise _explained(folder, error) from None
    finally:
        if client is None:
            connection.close()
    if client is None:
        raise NoSessionError(f"the socket in {folder} is that of user {listening}")
    return client


def _connect(connection: socket.socket, address: str) -> None:
    """Connect, also where many others do at the same moment."""
    deadline = time.monotonic() + ANSWER_LIMIT
    while True:
        try:
            connection.connect(address)
        except BlockingIOError:  # the queue of those that are to be accepted is full
            if time.monotonic() > deadline:
                raise TimeoutError from None
            time.sleep(_BUSY)
        else:
            return


def running() -> list[ControlClient]:
    """Connect to all sessions of this user that run; the links of dead ones are removed."""
    clients, _ = _look()
    return clients


def _look() -> tuple[list[ControlClient], list[str]]:
    clients: list[ControlClient] = []
    reasons: list[str] = []
    for link in registered():
        try:
            clients.append(connect_to(link.folder))
        except NoSessionError as error:
            if reason := _without_session(link, error):
                reasons.append(reason)
        except ControlError as error:
            reasons.append(f"{link.folder} (pid {link.pid}): {error}")
    return clients, reasons


def _only_one() -> ControlClient:
    clients, reasons = _look()
    if len(clients) == 1:
        return clients[0]
    for client in clients:
        client.close()
    if clients:
        raise AmbiguousSessionError(
            f"{len(clients)} sessions are running; choose one with --session (folder, name or "
            f"pid):\n{_listed([client.hello for client in clients])}"
        )
    raise NoSessionError(
        "\n  ".join(["no session is running; start one with play-launch replay", *reasons])
    )


def _in_utf8(text: str) -> str:
    """Read what came from a command line or path as UTF-8, whatever the locale is.

    In a locale without UTF-8, Python gives each byte from 128 on as a surrogate.
    """
    try:
        return os.fsencode(text).decode("utf-8", "surrogateescape")
    except UnicodeEncodeError:  # it came from a message, as the character that it is
        return text


def _listed(sessions: list[Hello]) -> str:
    return "\n".join(f"  {each.pid:>8}  {each.name}  {each.folder}" for each in sessions)


def _explained(folder: str, error: OSError | EOFError) -> Exception:
    """Say what an error on the way to a session means."""
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return NoSessionError(f"no session is running in {folder}")
    if isinstance(error, ConnectionRefusedError):
        return NoSessionError(
            f"no session is running in {folder}: its supervisor was killed, and left "
            f"{CONTROL_SOCKET} behind"
        )
    if isinstance(error, PermissionError):
        return NoSessionError(f"the session in {folder} is another user's: {error.strerror}")
    if isinstance(error, TimeoutError):
        return ControlError(Code.TIMEOUT, f"the session in {folder} does not answer")
    if isinstance(error, EOFError | ConnectionResetError):
        return NoSessionError(f"the session in {folder} has just ended")
    return ControlError(
        Code.INTERNAL, f"the session in {folder} does not answer: {error.strerror or error}"
    )


def _broken(error: OSError) -> ControlError:
    return ControlError(Code.INTERNAL, f"the connection ended: {error.strerror or error}")


def _hello(message: dict[str, Any]) -> Hello:
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
