"""A network with nothing but a loopback, and a /dev/shm, for a command and all that it starts.

``python loopback_network.py COMMAND ...`` replaces itself with the command. Discovery over the
default range, with multicast, then reaches everything in there, and nothing outside.

Fast DDS takes the number of a participant from the first UDP port that is free, and names queues in
/dev/shm after it. Two networks that share a /dev/shm take each other's queues away, so each has its
own.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import socket
import struct
import sys
from pathlib import Path

_CLONE_NEWNET = 0x40000000
_CLONE_NEWNS = 0x00020000
_CLONE_NEWUSER = 0x10000000
_MS_REC, _MS_PRIVATE = 0x4000, 0x40000
_SIOCGIFFLAGS, _SIOCSIFFLAGS = 0x8913, 0x8914
_IFF_UP, _IFF_MULTICAST = 0x1, 0x1000
_REQUEST = struct.Struct("16sh14x")
_REFUSED = 77
"""Exit code when the kernel does not permit it."""


def wrapped(*command: object) -> list[str]:
    """Return the command line that runs a command in a namespace of its own."""
    return [sys.executable, str(Path(__file__)), *map(str, command)]


_LIBC = ctypes.CDLL(None, use_errno=True)


def _checked(result: int) -> None:
    if result != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _enter() -> None:
    own = _CLONE_NEWNET | _CLONE_NEWNS
    user, group = os.geteuid(), os.getegid()
    try:
        _checked(_LIBC.unshare(own))
    except PermissionError:
        _checked(_LIBC.unshare(_CLONE_NEWUSER | own))
        Path("/proc/self/setgroups").write_text("deny", encoding="ascii")
        Path("/proc/self/uid_map").write_text(f"{user} {user} 1", encoding="ascii")
        Path("/proc/self/gid_map").write_text(f"{group} {group} 1", encoding="ascii")
    _mount_shared_memory()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        _, flags = _REQUEST.unpack(fcntl.ioctl(any_socket, _SIOCGIFFLAGS, _REQUEST.pack(b"lo", 0)))
        fcntl.ioctl(
            any_socket, _SIOCSIFFLAGS, _REQUEST.pack(b"lo", flags | _IFF_UP | _IFF_MULTICAST)
        )


def _mount_shared_memory() -> None:
    # What is mounted in here is not to be seen outside.
    _checked(_LIBC.mount(None, b"/", None, ctypes.c_ulong(_MS_REC | _MS_PRIVATE), None))
    _checked(_LIBC.mount(b"none", b"/dev/shm", b"tmpfs", ctypes.c_ulong(0), b"mode=1777"))


def leave_shared_memory() -> None:
    """Give this thread, and whatever it starts from now on, a /dev/shm of its own.

    Raises:
        OSError: When that is not permitted; it needs CAP_SYS_ADMIN.
    """
    _checked(_LIBC.unshare(_CLONE_NEWNS))
    _mount_shared_memory()


def permitted() -> bool:
    """Whether this kernel lets us make one."""
    child = os.fork()
    if child == 0:
        try:
            _enter()
        except OSError:
            os._exit(_REFUSED)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


if __name__ == "__main__":
    try:
        _enter()
    except OSError as error:
        sys.exit(f"no namespaces for a network and mounts: {error.strerror}")
    os.execvp(sys.argv[1], sys.argv[1:])
