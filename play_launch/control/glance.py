"""Asks all running sessions at once what runs in them, and takes what answers in time."""

from __future__ import annotations

import os
import select
import socket
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from play_launch.control.place import Link, address_of, peer_of, registered
from play_launch.control.protocol import (
    LONGEST_ANSWER,
    ControlError,
    LineSplitter,
    Request,
    decode,
    request_line,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

USUAL_LIMIT: Final = 0.15
"""Seconds: somebody has pressed a key, and looks at the screen."""
_PIECE: Final = 256 * 1024


class Seen(NamedTuple):
    """A session: its pid, its folder, its name and the rows that it answered with."""

    pid: int
    folder: str
    name: str
    rows: list[dict[str, Any]]


class _Asked:
    """A session that was asked, and what it has said so far."""

    def __init__(self, link: Link, connection: socket.socket) -> None:
        self._link = link
        self.connection = connection
        self._splitter = LineSplitter(LONGEST_ANSWER)
        self._name = ""
        self.seen: Seen | None = None

    def hear(self) -> bool:
        """Read what is there; False when nothing more is to come."""
        data = self.connection.recv(_PIECE)
        for message in map(decode, self._splitter.feed(data)):
            if "hello" in message:
                self._name = str(message["hello"]["name"])
            elif isinstance(message.get("result"), list):
                self.seen = Seen(
                    self._link.pid, self._link.folder, self._name, list(message["result"])
                )
        return bool(data) and self.seen is None


def glance(
    operation: str = "ps", names: Sequence[str] = (), *, limit: float = USUAL_LIMIT
) -> list[Seen]:
    """Ask all sessions of this user for the rows of ``ps``, or of another operation on names.

    Those that do not answer within the seconds are left out, as is one with which anything goes
    wrong.
    """
    request = Request(1, operation, {"names": list(names)})
    deadline = time.monotonic() + limit
    with ExitStack() as opened:
        asked = [
            found for link in registered() if (found := _ask(link, request, opened)) is not None
        ]
        waiting = {each.connection.fileno(): each for each in asked}
        poll = select.poll()
        for number in waiting:
            poll.register(number, select.POLLIN)
        while waiting and (left := deadline - time.monotonic()) > 0:
            for number, _ in poll.poll(left * 1e3):
                if not _goes_on(waiting[number]):
                    poll.unregister(number)
                    del waiting[number]
    return [each.seen for each in asked if each.seen is not None]


def _ask(link: Link, request: Request, opened: ExitStack) -> _Asked | None:
    connection = opened.enter_context(socket.socket(socket.AF_UNIX))
    connection.setblocking(False)
    try:
        with address_of(link.folder) as address:
            connection.connect(address)
        if os.geteuid() != 0 and peer_of(connection).uid not in {0, os.geteuid()}:
            return None
        connection.sendall(request_line(request))
    except OSError:
        return None
    return _Asked(link, connection)


def _goes_on(asked: _Asked) -> bool:
    try:
        return asked.hear()
    except BlockingIOError:
        return True
    except (OSError, ControlError, KeyError, TypeError):
        return False
