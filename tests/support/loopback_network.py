"""A network namespace with nothing but a loopback, for a command and all that it starts.

``python loopback_network.py COMMAND ...`` replaces itself with the command. Discovery over the
default range, with multicast, then reaches everything in there, and nothing outside.
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
_CLONE_NEWUSER = 0x10000000
_SIOCGIFFLAGS, _SIOCSIFFLAGS = 0x8913, 0x8914
_IFF_UP, _IFF_MULTICAST = 0x1, 0x1000
_REQUEST = struct.Struct("16sh14x")
_REFUSED = 77
"""Exit code when the kernel does not permit it."""


def wrapped(*command: object) -> list[str]:
    """Return the command line that runs a command in a namespace of its own."""
    return [sys.executable, str(Path(__file__)), *map(str, command)]


def _unshare(flags: int) -> None:
    library = ctypes.CDLL(None, use_errno=True)
    if library.unshare(flags) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _enter() -> None:
    try:
        _unshare(_CLONE_NEWNET)
    except PermissionError:
        _unshare(_CLONE_NEWUSER | _CLONE_NEWNET)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        _, flags = _REQUEST.unpack(fcntl.ioctl(any_socket, _SIOCGIFFLAGS, _REQUEST.pack(b"lo", 0)))
        fcntl.ioctl(
            any_socket, _SIOCSIFFLAGS, _REQUEST.pack(b"lo", flags | _IFF_UP | _IFF_MULTICAST)
        )


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
        sys.exit(f"no network namespace: {error.strerror}")
    os.execvp(sys.argv[1], sys.argv[1:])
