"""Where running sessions are found: a socket in the folder of each, and a link to each folder.

The links are in one folder for each user, ``/dev/shm/play_launch-<uid>/<pid>``: why there, says
docs/decisions/control.md. A link says where to look; whether a session runs says its socket, which
answers as long as its process lives.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

CONTROL_SOCKET: Final = "control.sock"
"""In the folder of a session; a killed supervisor leaves it behind."""
LINKS: Final = "PLAY_LAUNCH_SESSIONS_DIR"
"""Environment variable: where the links are instead, for systems that are to be kept apart."""
_CREDENTIALS: Final = struct.Struct("3i")


class Peer(NamedTuple):
    """Who is at the other end of a socket, as the kernel says."""

    pid: int
    uid: int
    gid: int


class Link(NamedTuple):
    """A session that registered itself, and may have been killed since."""

    pid: int
    folder: str


def links_folder() -> str:
    """Give the folder of the links of this user, which may not exist yet."""
    return os.environ.get(LINKS) or f"/dev/shm/play_launch-{os.geteuid()}"  # noqa: S108 - see links


def register(folder: str) -> str:
    """Link this process to the folder of its session and return the link.

    Raises:
        OSError: When that is not possible, or somebody else owns the folder of the links.
    """
    links = links_folder()
    os.makedirs(links, mode=0o700, exist_ok=True)  # noqa: PTH103 - pathlib is slow to import
    if not _is_ours(links):
        raise PermissionError(f"{links} belongs to another user")
    link = f"{links}/{os.getpid()}"
    with contextlib.suppress(FileNotFoundError):
        os.unlink(link)  # noqa: PTH108 - of a process that had the same pid
    os.symlink(folder, link)  # noqa: PTH211
    return link


def registered() -> list[Link]:
    """List the sessions that registered themselves, the oldest link first."""
    links = links_folder()
    found: list[tuple[int, Link]] = []
    if not _is_ours(links):
        return []
    for name in os.listdir(links):  # noqa: PTH208
        if not name.isdecimal():
            continue
        with contextlib.suppress(OSError):
            made = os.lstat(f"{links}/{name}").st_mtime_ns
            folder = os.readlink(f"{links}/{name}")  # noqa: PTH115
            found.append((made, Link(int(name), folder)))
    return [link for _, link in sorted(found)]


def forget(pid: int) -> bool:
    """Remove the link of a process that has ended; False: it lives, and keeps its link."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        with contextlib.suppress(OSError):
            os.unlink(f"{links_folder()}/{pid}")  # noqa: PTH108
        return True
    except OSError:
        pass
    return False


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


def _is_ours(folder: str) -> bool:
    """Whether a folder is no link, and belongs to the user who asks."""
    try:
        status = os.lstat(folder)
    except OSError:
        return False
    return status.st_uid == os.geteuid() and (status.st_mode & 0o170000) == 0o040000
