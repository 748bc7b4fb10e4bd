"""Sockets of running sessions, and the links by which commands find them.

The links are in one folder for each user, ``/dev/shm/play_launch-<uid>``; the reasons are in
docs/decisions/control.md. A session runs if its socket accepts connections. The name of a link is
``<pid>-<start time>-<PID namespace>`` of the supervisor: a pid may be reused, and containers may
share ``/dev/shm``.
"""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

from play_launch.recording.folder import CONTROL_SOCKET

if TYPE_CHECKING:
    from collections.abc import Iterator

"""In the folder of a session; a killed supervisor leaves it behind."""
LINKS: Final = "PLAY_LAUNCH_SESSIONS_DIR"
"""Environment variable: another folder for the links, for systems that are to be kept apart."""
SHARED_MEMORY: Final = "/dev/shm"  # noqa: S108 - see `_is_of`
_PREFIX: Final = "play_launch-"
_NUMBERS: Final = 3
_START_TIME: Final = 19
"""Index of the start time behind the program's name in /proc/<pid>/stat."""
_EXITED: Final = (b"Z", b"X")
"""States of a process that exited and was not reaped yet."""
_CREDENTIALS: Final = struct.Struct("3i")
_BACKLOG: Final = 128


class Peer(NamedTuple):
    """Credentials of the process at the other end of a socket."""

    pid: int
    """When it connected; it may be reused since."""
    uid: int
    gid: int


class RegisteredSession(NamedTuple):
    """A registered session; its supervisor may have been killed since."""

    pid: int
    folder: str
    start_time: int
    """In clock ticks after boot."""
    namespace: int
    """Inode of the PID namespace that the pid belongs to."""

    @property
    def name(self) -> str:
        return f"{self.pid}-{self.start_time}-{self.namespace}"


class ControlSocket:
    """Listening socket in the folder of a session, and its registration, until it is closed.

    It listens before anything is started: early clients queue until the server accepts.

    Attributes:
        folder: Of the session, absolute: commands have other working directories.
        socket: None if listening is not possible.
        problems: What is not possible, a sentence each.
    """

    def __init__(self, folder: str) -> None:
        """Listen, and register the session; errors become problems: the run matters more."""
        self.folder = str(Path(folder).absolute())
        self.socket: socket.socket | None = None
        self.problems: list[str] = []
        self._made: list[Path] = []
        try:
            self.socket = _listening(self.folder)
        except OSError as error:
            self.problems.append(
                f"the session cannot be controlled: no socket in {self.folder}: {error}"
            )
            return
        self._made.append(Path(self.folder, CONTROL_SOCKET))
        try:
            self._made.append(register(self.folder))
        except OSError as error:
            self.problems.append(
                f"commands find this session by --session {self.folder} only: "
                f"it is not registered: {error}"
            )

    def close(self) -> None:
        self.withdraw()
        if self.socket is not None:
            self.socket.close()

    def withdraw(self) -> None:
        """Remove socket file and link; to be called before the socket is closed."""
        while self._made:
            with contextlib.suppress(OSError):
                self._made.pop().unlink()


def _listening(folder: str) -> socket.socket:
    listening = socket.socket(socket.AF_UNIX)
    try:
        listening.setblocking(False)
        with address_of(folder) as address:
            # Before it is bound, so that no other user can connect.
            os.fchmod(listening.fileno(), 0o600)
            listening.bind(address)
        Path(folder, CONTROL_SOCKET).chmod(0o600)
        listening.listen(_BACKLOG)
    except BaseException:
        listening.close()
        raise
    return listening


def links_folder() -> Path:
    """Return the folder of this user's links, which may not exist yet."""
    return Path(os.environ.get(LINKS) or f"{SHARED_MEMORY}/{_PREFIX}{os.geteuid()}")


def register(folder: str) -> Path:
    """Link this process to the folder of its session and return the link; raises OSError."""
    links = links_folder()
    links.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not _is_of(os.geteuid(), links):
        raise PermissionError(f"{links} belongs to another user")
    path = links / RegisteredSession(os.getpid(), folder, _stat("self")[1], _namespace()).name
    path.unlink(missing_ok=True)  # of an earlier session of this process
    path.symlink_to(folder)
    return path


def registered() -> list[RegisteredSession]:
    return _links_in(links_folder(), os.geteuid())


def registered_by_others() -> list[tuple[int, RegisteredSession]]:
    """List live sessions of other users, each with the uid; for root only."""
    if os.geteuid() != 0 or os.environ.get(LINKS):
        return []
    with contextlib.suppress(OSError):
        return [
            (int(user), link)
            for folder in sorted(Path(SHARED_MEMORY).glob(f"{_PREFIX}*"))
            for user in (folder.name.removeprefix(_PREFIX),)
            if user.isdecimal() and int(user) != os.geteuid()
            for link in _links_in(folder, int(user))
            if is_alive(link)
        ]
    return []


def is_registered(link: RegisteredSession) -> bool:
    """Whether the link still exists: a session that ends removes it first."""
    return (links_folder() / link.name).is_symlink()


def is_alive(link: RegisteredSession) -> bool:
    """Whether the process that registered the session runs, in this PID namespace."""
    return _state(link) not in {None, *_EXITED}


def is_stopped(link: RegisteredSession) -> bool:
    """Whether a signal stopped that process, as Ctrl-Z does."""
    return _state(link) == b"T"


def _state(link: RegisteredSession) -> bytes | None:
    if not is_local(link):
        return None
    try:
        state, start_time = _stat(link.pid)
    except (FileNotFoundError, ProcessLookupError):
        return None
    return state if start_time == link.start_time else None


def is_local(link: RegisteredSession) -> bool:
    return link.namespace == _namespace()


def forget(link: RegisteredSession) -> None:
    with contextlib.suppress(OSError):
        (links_folder() / link.name).unlink()


def peer_of(connection: socket.socket) -> Peer:
    """Return the credentials of the other end; of a listener, those at its ``listen``."""
    data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    return Peer(*_CREDENTIALS.unpack(data))


@contextlib.contextmanager
def address_of(folder: str) -> Iterator[str]:
    """Yield an address of the socket in a folder, valid while the block runs.

    An address has at most 107 bytes, and a path 4,095: it goes by a descriptor of the folder.
    Raises ``OSError`` when there is no such folder.
    """
    descriptor = os.open(folder, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{descriptor}/{CONTROL_SOCKET}"
    finally:
        os.close(descriptor)


def _links_in(links: Path, user: int) -> list[RegisteredSession]:
    found: list[tuple[int, RegisteredSession]] = []
    if not _is_of(user, links):
        return []
    for path in links.iterdir():
        numbers = path.name.split("-")
        if len(numbers) != _NUMBERS or not all(number.isdecimal() for number in numbers):
            continue
        pid, start_time, namespace = map(int, numbers)
        with contextlib.suppress(OSError):
            link = RegisteredSession(pid, str(path.readlink()), start_time, namespace)
            found.append((path.lstat().st_mtime_ns, link))
    return [link for _, link in sorted(found)]


def _is_of(user: int, folder: Path) -> bool:
    """Whether a path is a folder, not a link, and belongs to that user."""
    try:
        status = folder.lstat()
    except OSError:
        return False
    return status.st_uid == user and stat.S_ISDIR(status.st_mode)


def _stat(pid: int | Literal["self"]) -> tuple[bytes, int]:
    fields = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()
    return fields[0], int(fields[_START_TIME])


def _namespace() -> int:
    return Path("/proc/self/ns/pid").stat().st_ino
