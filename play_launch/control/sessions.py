"""Finds the sessions that are registered, and chooses the one that a command is meant for.

All are asked at once. Choosing goes by what is registered and alive, never by which sessions
answer: a command must not reach another robot because the one that is meant hangs.
"""

from __future__ import annotations

import os
import re
import select
import socket
import time
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from play_launch.control.client import ANSWER_LIMIT, ControlClient, Hello, hello_of
from play_launch.control.place import (
    CONTROL_SOCKET,
    Link,
    Registrant,
    address_of,
    forget,
    is_registered,
    peer_of,
    registered,
    registered_by_others,
    registrant_of,
)
from play_launch.control.protocol import (
    LONGEST_ANSWER,
    Code,
    ControlError,
    LineSplitter,
    Request,
    decode,
    request_line,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

COMPLETION_LIMIT: Final = 0.15
"""Seconds for the answers that a shell waits for after a key was pressed."""
_LISTING_LIMIT: Final = 1.0
"""Seconds for the names of sessions in an error that lists them."""
_MOST_OF_OTHERS: Final = 20
"""Sessions of other users that are listed."""
_BUSY: Final = 0.01
"""Seconds between two tries to connect where many do."""
_PIECE: Final = 256 * 1024
_STAMP: Final = re.compile(r"\d{4}(-\d\d){5}-")
"""What the names of folders of sessions begin with; the name of the session follows."""
_LONGEST_NAME: Final = 100
"""Characters of it."""


class NoSessionError(Exception):
    """There is no session to talk to, or it is not clear which one; the text names the fix."""


class AmbiguousSessionError(NoSessionError):
    """There are several; the text lists them."""


class Found(NamedTuple):
    """What was found where a session is registered, or is said to be."""

    link: Link
    client: ControlClient | None
    """The connection, where the session has greeted."""
    answer: Any
    """The result of what was asked; None: there is none."""
    problem: NoSessionError | ControlError | None
    """Why there is no client."""
    registrant: Registrant
    """Whether the session is alive, be it one that does not answer."""

    @property
    def is_alive(self) -> bool:
        """Whether there is a session as far as can be seen from here."""
        return self.registrant is Registrant.ALIVE


class Seen(NamedTuple):
    """A session: its pid, its folder, its name and the rows that it answered with."""

    pid: int
    folder: str
    name: str
    rows: list[dict[str, Any]]


def connect(session: str | None = None, *, limit: float = ANSWER_LIMIT) -> ControlClient:
    """Connect to the running session, or to the one that is named.

    Args:
        session: Folder, pid or name of a session; None where only one runs.
        limit: Seconds for its greeting.

    Raises:
        NoSessionError: When there is none, or more than one.
        ControlError: When it does not let us in.
    """
    if session is not None and _is_folder(session):
        return connect_to(session, limit=limit)
    links = registered()
    meant = [link for link in links if session is None or str(link.pid) == session]
    is_pid = session is not None and bool(meant)
    if session is not None and not meant:
        meant = [link for link in links if _may_be_called(link, session)]
    # Two that are alive are too many, whatever they say; then only their names are waited for.
    is_decided = session is None and len(meant) > 1
    found = find(meant, min(limit, _LISTING_LIMIT) if is_decided else limit)
    chosen: Found | None = None
    try:
        chosen = choose(found, session, is_pid=is_pid)
    except AmbiguousSessionError:
        raise
    except NoSessionError as error:
        others = find([link for link in links if link not in meant], min(limit, _LISTING_LIMIT))
        close(others)
        known = [each for each in (*found, *others) if each.is_alive]
        text = str(error)
        if known and session is not None and not is_pid:
            text += f"; these are running:\n{_listed(known)}"
        raise NoSessionError(text + _of_others()) from None
    finally:
        close(each for each in found if each is not chosen)
    if is_decided and isinstance(chosen.problem, ControlError):
        return connect_to(chosen.link.folder, limit=limit)  # the others have ended
    return _opened(chosen)


def connect_to(folder: str, *, limit: float = ANSWER_LIMIT) -> ControlClient:
    """Connect to the session in a folder.

    Raises:
        NoSessionError: When none runs there, with what is left of one.
        ControlError: When it does not let us in.
    """
    (found,) = find([Link(0, folder, 0, 0)], limit)
    return _opened(found)


def choose(found: Sequence[Found], session: str | None, *, is_pid: bool = False) -> Found:
    """Choose from what may be meant.

    Args:
        found: What is registered: all, or what bears that pid, or may bear that name.
        session: Name or pid of the session; None: there is only one.
        is_pid: Whether it is a pid.

    Raises:
        NoSessionError: When none of them is alive, or more than one.
    """
    alive = [each for each in found if each.is_alive]
    is_name = session is not None and not is_pid
    if session is not None and is_name:
        alive = [each for each in alive if each.client is None or _is_called(each.client, session)]
    if len(alive) == 1:
        return alive[0]
    if alive:
        text = "are running; choose one with --session (folder, name or pid)"
        if session is not None:
            may_be = "are" if all(each.client for each in alive) else "are, or may be,"
            text = f"{may_be} called {session}; name the folder{' or the pid' if is_name else ''}"
        raise AmbiguousSessionError(f"{len(alive)} sessions {text}:\n{_listed(alive)}")
    reasons = [str(each.problem) for each in found if is_pid or each.registrant is Registrant.GONE]
    if is_name:
        reasons.insert(
            0,
            f"there is no session {session}: it is no folder with a {CONTROL_SOCKET}, and no pid "
            "or name of a running session",
        )
    elif session is None:
        reasons.insert(0, "no session of yours is running; start one with play-launch replay")
    raise NoSessionError("\n  ".join(reasons))


def glance(
    operation: str = "ps", names: Sequence[str] = (), *, limit: float = COMPLETION_LIMIT
) -> list[Seen]:
    """Ask all sessions of this user for the rows of ``ps``, or of another operation on names.

    Those that do not answer within the seconds are left out, as is one with which anything goes
    wrong.
    """
    found = find(registered(), limit, Request(1, operation, {"names": list(names)}))
    close(found)
    return [
        Seen(each.link.pid, each.link.folder, each.client.hello.name, each.answer)
        for each in found
        if each.client is not None and isinstance(each.answer, list)
    ]


def find(links: Sequence[Link], limit: float, request: Request | None = None) -> list[Found]:
    """Connect to all of them at once, and ask them something; the links of dead ones are removed.

    The caller closes the clients. A session that does not answer within ``limit`` seconds is
    alive nevertheless.
    """
    asked = [_Asked(link, b"" if request is None else request_line(request)) for link in links]
    deadline = time.monotonic() + limit
    poll = select.poll()
    coming = {each.connection.fileno(): each for each in asked}
    waiting: dict[int, _Asked] = {}
    while True:
        for number, each in tuple(coming.items()):
            if each.connects():
                del coming[number]
                waiting[number] = each
                poll.register(number, select.POLLIN)
        for number in [number for number, each in waiting.items() if each.is_done]:
            poll.unregister(number)
            del waiting[number]
        left = deadline - time.monotonic()
        if left <= 0 or not (coming or waiting):
            break
        for number, _ in poll.poll((min(left, _BUSY) if coming else left) * 1e3):
            waiting[number].hear()
    return [each.found() for each in asked]


def close(found: Iterable[Found]) -> None:
    """Close the connections."""
    for each in found:
        if each.client is not None:
            each.client.close()


class _Asked:
    """A session that is asked, and what it has said so far."""

    def __init__(self, link: Link, line: bytes) -> None:
        self.connection = socket.socket(socket.AF_UNIX)
        self.connection.setblocking(False)
        self._link = link
        self._line = line
        self._splitter = LineSplitter(LONGEST_ANSWER)
        self._hello: Hello | None = None
        self._answer: Any = None
        self._problem: NoSessionError | ControlError | None = None
        self.is_done = False

    def connects(self) -> bool:
        """Connect, and ask; False: others do at this moment, so that it is to be tried again."""
        try:
            with address_of(self._link.folder) as address:
                self.connection.connect(address)
            if self._line:
                self.connection.sendall(self._line)
            listening = peer_of(self.connection).uid
        except BlockingIOError:
            return False
        except OSError as error:
            self._give_up(_explained(self._link.folder, error))
            return True
        if os.geteuid() != 0 and listening not in {0, os.geteuid()}:
            text = f"the socket in {self._link.folder} is that of user {listening}"
            self._give_up(NoSessionError(text))
        return True

    def hear(self) -> None:
        """Read what is there."""
        try:
            data = self.connection.recv(_PIECE)
            for message in map(decode, self._splitter.feed(data)):
                if self._hello is None:
                    self._hello = hello_of(message)
                    self.is_done = not self._line
                else:
                    self._answer = message.get("result")
                    self.is_done = True
        except BlockingIOError:
            return
        except OSError as error:
            self._give_up(_explained(self._link.folder, error))
        except ControlError as error:
            self._give_up(error)
        else:
            if not data:
                self._give_up(_explained(self._link.folder, ConnectionResetError()))

    def found(self) -> Found:
        """Say what there is."""
        if self._hello is not None:
            client = ControlClient(self.connection, self._hello)
            return Found(self._link, client, self._answer, None, Registrant.ALIVE)
        self.connection.close()
        problem = self._problem or _explained(self._link.folder, TimeoutError())
        if isinstance(problem, ControlError):  # something listens
            return Found(self._link, None, None, problem, Registrant.ALIVE)
        problem, registrant = _without_session(self._link, problem)
        return Found(self._link, None, None, problem, registrant)

    def _give_up(self, problem: NoSessionError | ControlError) -> None:
        self._problem = problem
        self.is_done = True


def _opened(found: Found) -> ControlClient:
    if found.client is None:
        assert found.problem is not None
        raise found.problem
    return found.client


def _without_session(link: Link, error: NoSessionError) -> tuple[NoSessionError, Registrant]:
    """Say what there is in place of a registered session, and whether it is alive."""
    if not is_registered(link):
        return error, Registrant.GONE  # it has ended meanwhile
    registrant = registrant_of(link)
    match registrant:
        case Registrant.GONE:
            forget(link)
        case Registrant.ALIVE:
            error = NoSessionError(
                f"{error}; process {link.pid}, which registered it, still runs: its folder was "
                f"moved or removed; kill -INT {link.pid} ends it in order"
            )
    return error, registrant


def _is_folder(session: str) -> bool:
    """Whether a folder is meant, not a name or pid that a folder here happens to have as well."""
    return "/" in session or os.path.lexists(f"{session}/{CONTROL_SOCKET}")


def _may_be_called(link: Link, session: str) -> bool:
    """Whether a session may have that name, as far as its folder says."""
    name = os.path.basename(link.folder.rstrip("/"))  # noqa: PTH119 - pathlib is slow to import
    stamp = _STAMP.match(name)
    if stamp is None or _in_utf8(name) == _in_utf8(session):
        return True
    name = name[stamp.end() :]
    # Other characters are replaced there, a number may follow, and long names are cut off.
    plain, wanted = (re.sub("[^A-Za-z0-9]", "", text) for text in (name, session))
    return (
        plain == wanted
        or plain.removeprefix(wanted).isdecimal()
        or not wanted
        or len(name) >= _LONGEST_NAME
    )


def _is_called(client: ControlClient, session: str) -> bool:
    names = (client.hello.name, os.path.basename(client.hello.folder))  # noqa: PTH119
    return _in_utf8(session) in {_in_utf8(name) for name in names}


def _in_utf8(text: str) -> str:
    """Read what came from a command line or path as UTF-8, whatever the locale is.

    In a locale without UTF-8, Python gives each byte from 128 on as a surrogate.
    """
    try:
        return os.fsencode(text).decode("utf-8", "surrogateescape")
    except UnicodeEncodeError:  # it came from a message, as the character that it is
        return text


def _listed(found: Iterable[Found]) -> str:
    return "\n".join(f"  {_line(each)}" for each in found)


def _line(found: Found) -> str:
    if found.client is not None:
        hello = found.client.hello
        return f"{hello.pid:>8}  {hello.name}  {hello.folder}"
    text, folder = str(found.problem), found.link.folder
    return f"{found.link.pid:>8}  {text if folder in text else f'{folder}: {text}'}"


def _of_others() -> str:
    """List the sessions of other users, which root reaches by their folders."""
    found = registered_by_others()
    if not found:
        return ""
    import pwd  # noqa: PLC0415 - rarely needed

    lines = ["\nsessions of other users, to be named with --session FOLDER:"]
    for user, link in found[:_MOST_OF_OTHERS]:
        try:
            name = pwd.getpwuid(user).pw_name
        except KeyError:
            name = str(user)
        folder = link.folder if link.folder.isprintable() else repr(link.folder)
        lines.append(f"{link.pid:>8}  user {name}  {folder}")
    if len(found) > _MOST_OF_OTHERS:
        lines.append(f"{'':>8}  and {len(found) - _MOST_OF_OTHERS} more")
    return "\n  ".join(lines)


def _explained(folder: str, error: OSError) -> NoSessionError | ControlError:
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
    if isinstance(error, ConnectionResetError | BrokenPipeError):
        return NoSessionError(f"the session in {folder} has just ended")
    return NoSessionError(f"the session in {folder} does not answer: {error.strerror or error}")
