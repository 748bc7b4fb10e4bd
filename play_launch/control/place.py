"""Where running sessions are found: a socket in the folder of each, and a link to each folder.

The links are in one folder for each user, ``/dev/shm/play_launch-<uid>``: why there, says
docs/decisions/control.md. A link says where to look; whether a session runs says its socket, which
answers as long as its process lives. The name of a link is ``<pid>-<start time>-<PID namespace>``:
which process registered the session, also where its pid has a new owner, or another one in another
container with the same ``/dev/shm``.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from enum import Enum
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

CONTROL_SOCKET: Final = "control.sock"
"""In the folder of a session; a killed supervisor leaves it behind."""
LINKS: Final = "PLAY_LAUNCH_SESSIONS_DIR"
"""Environment variable: where the links are instead, for systems that are to be kept apart."""
SHARED_MEMORY: Final = "/dev/shm"  # noqa: S108 - see `_is_of`
_PREFIX: Final = "play_launch-"
_NUMBERS: Final = 3
_START_TIME: Final = 19
"""Index in what follows the name of the program in /proc/<pid>/stat."""
_DEAD: Final = (b"Z", b"X")
"""States of a process that has ended and was not waited for yet."""
_CREDENTIALS: Final = struct.Struct("3i")


class Peer(NamedTuple):
    """Who is at the other end of a socket, as the kernel says."""

    pid: int
    """When it connected; by now, another process may have it."""
    uid: int
    gid: int
    command: tuple[str, ...] = ()
    """Its command line, as it says itself with each request."""


class Link(NamedTuple):
    """A session that registered itself, and may have been killed since."""

    pid: int
    folder: str
    start_time: int
    """In clock ticks after boot."""
    namespace: int
    """Inode of the PID namespace that the pid belongs to."""

    @property
    def name(self) -> str:
        """The name of the link."""
        return f"{self.pid}-{self.start_time}-{self.namespace}"


class Registrant(Enum):
    """What is known of the process that registered a session."""

    GONE = "gone"
    ALIVE = "alive"
    UNKNOWN = "unknown"
    """It is, or was, in another PID namespace."""


def links_folder() -> str:
    """Give the folder of the links of this user, which may not exist yet."""
    return os.environ.get(LINKS) or f"{SHARED_MEMORY}/{_PREFIX}{os.geteuid()}"


def register(folder: str) -> str:
    """Link this process to the folder of its session and return the link.

    Raises:
        OSError: When that is not possible, or somebody else owns the folder of the links.
    """
    links = links_folder()
    os.makedirs(links, mode=0o700, exist_ok=True)  # noqa: PTH103 - pathlib is slow to import
    if not _is_of(os.geteuid(), links):
        raise PermissionError(f"{links} belongs to another user")
    link = Link(os.getpid(), folder, _state_and_start("self")[1], _namespace())
    path = f"{links}/{link.name}"
    with contextlib.suppress(FileNotFoundError):
        os.unlink(path)  # noqa: PTH108 - of an earlier session of this process
    os.symlink(folder, path)  # noqa: PTH211
    return path


def registered() -> list[Link]:
    """List the sessions that registered themselves, the oldest link first."""
    return _links_in(links_folder(), os.geteuid())


def registered_by_others() -> list[tuple[int, Link]]:
    """List sessions of other users that are alive, each with the user's number; only root may."""
    if os.geteuid() != 0 or os.environ.get(LINKS):
        return []
    found: list[tuple[int, Link]] = []
    try:
        names = sorted(os.listdir(SHARED_MEMORY))  # noqa: PTH208
    except OSError:
        return []
    for name in names:
        number = name.removeprefix(_PREFIX)
        if number != name and number.isdecimal() and int(number) != os.geteuid():
            user = int(number)
            links = _links_in(f"{SHARED_MEMORY}/{name}", user)
            found += [(user, each) for each in links if registrant_of(each) is Registrant.ALIVE]
    return found


def _links_in(links: str, user: int) -> list[Link]:
    found: list[tuple[int, Link]] = []
    if not _is_of(user, links):
        return []
    for name in os.listdir(links):  # noqa: PTH208
        numbers = name.split("-")
        if len(numbers) != _NUMBERS or not all(number.isdecimal() for number in numbers):
            continue
        pid, start_time, namespace = map(int, numbers)
        if f"{pid}-{start_time}-{namespace}" != name:
            continue
        with contextlib.suppress(OSError):
            made = os.lstat(f"{links}/{name}").st_mtime_ns
            folder = os.readlink(f"{links}/{name}")  # noqa: PTH115
            found.append((made, Link(pid, folder, start_time, namespace)))
    return [link for _, link in sorted(found)]


def is_registered(link: Link) -> bool:
    """Whether the link is still there: a session that ends removes it first."""
    return os.path.lexists(f"{links_folder()}/{link.name}")


def registrant_of(link: Link) -> Registrant:
    """Look for the process that registered a session."""
    # With the /proc of another PID namespace nothing can be said about a pid.
    if link.namespace != _namespace() or os.readlink("/proc/self") != str(os.getpid()):  # noqa: PTH115
        return Registrant.UNKNOWN
    try:
        state, start_time = _state_and_start(link.pid)
        is_it = start_time == link.start_time and state not in _DEAD
    except (FileNotFoundError, ProcessLookupError):
        is_it = False
    return Registrant.ALIVE if is_it else Registrant.GONE


def forget(link: Link) -> None:
    """Remove the link of a process that has ended."""
    with contextlib.suppress(OSError):
        os.unlink(f"{links_folder()}/{link.name}")  # noqa: PTH108


def peer_of(connection: socket.socket) -> Peer:
    """Give who is at the other end; who listens is whoever called ``listen``."""
    data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    return Peer(*_CREDENTIALS.unpack(data))


@contextlib.contextmanager
def address_of(folder: str) -> Iterator[str]:
    """Give an address of the socket in a folder, for as long as the block runs.

    The address of a socket has at most 107 bytes, and a folder's path may have 4,095: the address
    goes by a descriptor of the folder. Raises ``OSError`` when there is no such folder.
    """
    descriptor = os.open(folder, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{descriptor}/{CONTROL_SOCKET}"
    finally:
        os.close(descriptor)


def _is_of(user: int, folder: str) -> bool:
    """Whether a folder is no link, and belongs to that user."""
    try:
        status = os.lstat(folder)
    except OSError:
        return False
    return status.st_uid == user and (status.st_mode & 0o170000) == 0o040000


def _state_and_start(pid: int | Literal["self"]) -> tuple[bytes, int]:
    with open(f"/proc/{pid}/stat", "rb") as file:  # noqa: PTH123
        fields = file.read().rpartition(b")")[2].split()
    return fields[0], int(fields[_START_TIME])


def _namespace() -> int:
    return os.stat("/proc/self/ns/pid").st_ino  # noqa: PTH116
