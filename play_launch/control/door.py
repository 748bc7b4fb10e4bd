"""The socket of a session.

It is there before anything starts: who comes early waits until somebody answers.
"""

from __future__ import annotations

import contextlib
import os
import socket
from typing import Final

from play_launch.control.place import CONTROL_SOCKET, address_of, register

_BACKLOG: Final = 128


class Door:
    """Listens in the folder of a session, and has commands find it, until it is closed.

    Attributes:
        folder: Of the session, absolute: commands have other working directories.
        socket: What listens; None where that is not possible.
        problems: What is not possible, a sentence each.
    """

    def __init__(self, folder: str) -> None:
        """Listen, and register the session; nothing is raised, since the run matters more."""
        self.folder = os.path.abspath(folder)  # noqa: PTH100 - pathlib is slow to import
        self.socket: socket.socket | None = None
        self.problems: list[str] = []
        self._made: list[str] = []
        try:
            self.socket = _listening(self.folder)
        except OSError as error:
            self.problems.append(
                f"the session cannot be controlled: no socket in {self.folder}: {error}"
            )
            return
        self._made.append(f"{self.folder}/{CONTROL_SOCKET}")
        try:
            self._made.append(register(self.folder))
        except OSError as error:
            self.problems.append(
                f"commands find this session by --session {self.folder} only: "
                f"it is not registered: {error}"
            )

    def close(self) -> None:
        """Withdraw, and listen no longer."""
        self.withdraw()
        if self.socket is not None:
            self.socket.close()

    def withdraw(self) -> None:
        """Be found no longer; to be called before what listens is closed."""
        while self._made:
            with contextlib.suppress(OSError):
                os.unlink(self._made.pop())  # noqa: PTH108 - as above


def _listening(folder: str) -> socket.socket:
    listening = socket.socket(socket.AF_UNIX)
    try:
        listening.setblocking(False)
        with address_of(folder) as address:
            # Nobody else may connect, from the first moment on.
            os.fchmod(listening.fileno(), 0o600)
            listening.bind(address)
        os.chmod(f"{folder}/{CONTROL_SOCKET}", 0o600)  # noqa: PTH101 - as above
        listening.listen(_BACKLOG)
    except BaseException:
        listening.close()
        raise
    return listening
