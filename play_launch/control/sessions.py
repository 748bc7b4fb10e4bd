"""Finds the registered sessions, and chooses the one that a command is meant for.

All are queried at once. The choice depends on what is registered and alive, never on which sessions
answer: a command must not reach another robot because the right one hangs.
"""

from __future__ import annotations

import contextlib
import os
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from play_launch.control.client import TIMEOUT, ControlClient, SessionInfo
from play_launch.control.protocol import Code, OperationError
from play_launch.control.registration import (
    RegisteredSession,
    forget,
    is_alive,
    is_local,
    is_registered,
    is_stopped,
    registered,
    registered_by_others,
)
from play_launch.recording.folder import CONTROL_SOCKET

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

COMPLETION_TIMEOUT: Final = 0.15
"""Seconds for the answers that a shell waits for after a key was pressed."""
_LISTING_TIMEOUT: Final = 1.0
"""Seconds for the names of sessions in an error that lists them."""
_OTHERS_LIMIT: Final = 20
"""Sessions of other users that are listed."""
_STAMP: Final = re.compile(r"\d{4}(-\d\d){5}-")
"""Prefix of the folders of sessions; the name of the session follows."""
_CUT: Final = 60
"""Letters and digits of a name that may have been cut off in its folder, at 100 characters."""


class NoSessionError(Exception):
    """There is no such session; the text has the fix."""


class AmbiguousSessionError(NoSessionError):
    """There are several; the text lists them."""


class SessionAnswer(NamedTuple):
    """A registered session and its answer."""

    link: RegisteredSession
    client: ControlClient | None
    """The connection, if the session has sent its hello."""
    answer: Any
    """Result of the request, if any."""
    problem: NoSessionError | OperationError | None
    """Why there is no client."""
    is_alive: bool
    """Whether the session runs, also without an answer."""
    has_exited: bool
    """Whether it is known that it does not run; neither holds in another PID namespace."""


def connect(session: str | None = None, *, limit: float = TIMEOUT) -> ControlClient:
    """Connect to the running session, or to the named one.

    ``session`` is a folder, pid or name; its hello has to come within ``limit`` seconds. Raises
    NoSessionError when no session runs, or more than one, and OperationError when it refuses, or
    does not answer.
    """
    if session is not None and _is_folder(session):
        return connect_to(session, limit=limit)
    links = registered()
    by_pid = [link for link in links if str(link.pid) == session]
    name = None if by_pid else session
    meant = by_pid or [link for link in links if name is None or _may_be_called(link, name)]
    # Two live sessions are ambiguous whatever they answer; only their names are waited for.
    listing = min(limit, _LISTING_TIMEOUT)
    is_decided = session is None and len(meant) > 1
    found = find(meant, listing if is_decided else limit)
    alive = [
        each
        for each in found
        if each.is_alive and (name is None or each.client is None or _is_called(each.client, name))
    ]
    alive = _without_parts(alive)
    close(each for each in found if [each] != alive)
    if len(alive) == 1:
        if is_decided and isinstance(alive[0].problem, OperationError):
            return connect_to(alive[0].link.folder, limit=limit)  # the others have ended
        return _client_of(alive[0])
    if alive:
        text = "are running; choose one with --session (folder, name or pid)"
        if session is not None:
            may_be = "are" if all(each.client for each in alive) else "are, or may be,"
            text = f"{may_be} called {session}; name the folder{' or the pid' if name else ''}"
        raise AmbiguousSessionError(f"{len(alive)} sessions {text}:\n{_listed(alive)}")
    reasons = [str(each.problem) for each in found if by_pid or each.has_exited]
    if session is None:
        reasons.insert(0, "no session of yours is running; start one with play-launch replay")
    elif name is not None:
        reasons.insert(
            0,
            f"there is no session {session}: it is no folder with a {CONTROL_SOCKET}, and no pid "
            "or name of a running session",
        )
    text = "\n  ".join(reasons)
    others = find([link for link in links if link not in meant], listing)
    close(others)
    known = [each for each in (*found, *others) if each.is_alive]
    if known and name is not None:
        text += f"; these are running:\n{_listed(known)}"
    raise NoSessionError(text + _of_others())


def connect_to(folder: str, *, limit: float = TIMEOUT) -> ControlClient:
    """Connect to the session in a folder; raises NoSessionError, OperationError."""
    return _client_of(_found(RegisteredSession(0, folder, 0, 0), limit))


def glance(operation: str, names: Sequence[str]) -> list[tuple[SessionInfo, list[dict[str, Any]]]]:
    """Request the rows of an operation on names from all sessions of the user.

    Sessions that do not answer in time are left out.
    """
    found = find(registered(), COMPLETION_TIMEOUT, operation, names)
    close(found)
    return [
        (each.client.hello, each.answer)
        for each in found
        if each.client is not None and isinstance(each.answer, list)
    ]


def twins(
    names: Collection[str], domain: str, *, but: str = ""
) -> list[tuple[SessionInfo, list[str]]]:
    """Find other sessions of the user that run units of these names in a ROS domain.

    Sessions called ``but`` do not count, nor do those that do not answer in time.
    """
    others = [link for link in registered() if link.pid != os.getpid()]
    found = find(others, _LISTING_TIMEOUT, "ps")
    same: list[tuple[SessionInfo, list[str]]] = []
    for each in found:
        if each.client is None or each.client.hello.name == but:
            continue
        rows = each.answer or ()
        up = {row["name"] for row in rows if row["state"] in {"running", "loaded"}}
        if shared := sorted(up.intersection(names)):
            with contextlib.suppress(OperationError):
                its = each.client.ask("environment", limit=_LISTING_TIMEOUT)
                if (its.get("ROS_DOMAIN_ID") or "0") == domain:
                    same.append((each.client.hello, shared))
    close(found)
    return same


def find(
    links: Sequence[RegisteredSession], limit: float, operation: str = "", names: Sequence[str] = ()
) -> list[SessionAnswer]:
    """Connect to all of them at once, with a request if given; links of exited ones are removed.

    The caller closes the clients. A session that does not answer within ``limit`` seconds is
    alive all the same.
    """
    if len(links) <= 1:
        return [_found(link, limit, operation, names) for link in links]
    from threading import Thread  # noqa: PLC0415 - for several sessions only

    found: dict[RegisteredSession, SessionAnswer] = {}

    def query(link: RegisteredSession) -> None:
        found[link] = _found(link, limit, operation, names)

    threads = [Thread(target=query, args=(link,), daemon=True) for link in links]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return [found[link] for link in links]


def close(found: Iterable[SessionAnswer]) -> None:
    for each in found:
        if each.client is not None:
            each.client.close()


def _found(
    link: RegisteredSession, limit: float, operation: str = "", names: Sequence[str] = ()
) -> SessionAnswer:
    deadline = time.monotonic() + limit
    try:
        client = ControlClient(link.folder, limit)
    except OperationError as error:  # something listens
        return SessionAnswer(link, None, None, error, is_alive=True, has_exited=False)
    except TimeoutError:
        text = f"the session in {link.folder} does not answer{_of_stopped(link.folder)}"
        problem = OperationError(Code.TIMEOUT, text)
        return SessionAnswer(link, None, None, problem, is_alive=True, has_exited=False)
    except (OSError, EOFError) as error:
        return _without_session(link, _explained(link.folder, error))
    answer = None
    if operation:
        try:
            left = max(deadline - time.monotonic(), 0.0)
            answer = client.ask(operation, {"names": list(names)}, limit=left)
        except OperationError:
            pass
    return SessionAnswer(link, client, answer, None, is_alive=True, has_exited=False)


def _of_stopped(folder: str) -> str:
    for link in registered():
        if is_stopped(link) and os.path.realpath(link.folder) == os.path.realpath(folder):
            return (
                f": a signal stopped its process {link.pid}, as Ctrl-Z does; fg in its shell, or "
                f"kill -CONT {link.pid}, continues it"
            )
    return ""


def _client_of(found: SessionAnswer) -> ControlClient:
    if found.client is None:
        assert found.problem is not None
        raise found.problem
    return found.client


def _without_session(link: RegisteredSession, error: NoSessionError) -> SessionAnswer:
    """Return what there is in place of a registered session."""
    lives = is_registered(link) and is_alive(link)
    has_exited = not is_registered(link) or (is_local(link) and not lives)
    if lives:
        error = NoSessionError(
            f"{error}; process {link.pid}, which registered it, still runs: its folder was "
            f"moved or removed; kill -INT {link.pid} ends it in order"
        )
    elif has_exited:
        forget(link)
    return SessionAnswer(link, None, None, error, is_alive=lives, has_exited=has_exited)


def _without_parts(alive: list[SessionAnswer]) -> list[SessionAnswer]:
    """Leave out the local part of a system whose coordinator runs here too, and includes it."""
    hellos = [each.client.hello for each in alive if each.client is not None]
    whole = {hello.name for hello in hellos if not hello.machine}
    return [
        each
        for each in alive
        if each.client is None
        or not each.client.hello.machine
        or each.client.hello.name not in whole
    ]


def _is_folder(session: str) -> bool:
    """Whether it means a folder, not a name or pid that a folder here happens to have as well."""
    return "/" in session or os.path.lexists(f"{session}/{CONTROL_SOCKET}")


def _may_be_called(link: RegisteredSession, session: str) -> bool:
    """Whether a session may have that name, as far as its folder shows."""
    name = Path(link.folder).name
    if name == session or not _STAMP.match(name):
        return True
    # Other characters are replaced there, a number may follow, and long names are cut off.
    plain, wanted = (re.sub("[^A-Za-z0-9]", "", text) for text in (_STAMP.sub("", name), session))
    return plain.startswith(wanted) or (len(plain) > _CUT and wanted.startswith(plain))


def _is_called(client: ControlClient, session: str) -> bool:
    return session in {client.hello.name, Path(client.hello.folder).name}


def _listed(found: Iterable[SessionAnswer]) -> str:
    return "\n".join(f"  {_line(each)}" for each in found)


def _line(found: SessionAnswer) -> str:
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
    for user, link in found[:_OTHERS_LIMIT]:
        try:
            name = pwd.getpwuid(user).pw_name
        except KeyError:
            name = str(user)
        folder = link.folder if link.folder.isprintable() else repr(link.folder)
        lines.append(f"{link.pid:>8}  user {name}  {folder}")
    if len(found) > _OTHERS_LIMIT:
        lines.append(f"{'':>8}  and {len(found) - _OTHERS_LIMIT} more")
    return "\n  ".join(lines)


def _explained(folder: str, error: OSError | EOFError) -> NoSessionError:
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return NoSessionError(f"no session is running in {folder}")
    if isinstance(error, ConnectionRefusedError):
        return NoSessionError(
            f"no session is running in {folder}: its supervisor was killed, and left "
            f"{CONTROL_SOCKET} behind"
        )
    if isinstance(error, PermissionError):
        return NoSessionError(f"the session in {folder} is another user's: {error.strerror}")
    if isinstance(error, EOFError | ConnectionResetError | BrokenPipeError):
        return NoSessionError(f"the session in {folder} has just ended")
    return NoSessionError(f"the session in {folder} does not answer: {error.strerror or error}")
