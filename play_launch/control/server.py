"""Listens on the control socket of a session while it runs."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import sys
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from play_launch.control.connection import Connection, Room
from play_launch.control.protocol import PROTOCOL, encode

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Coroutine

    from play_launch.control.connection import Operate
    from play_launch.control.door import Door
    from play_launch.control.place import Peer

MOST_CLIENTS: Final = 128
"""Connections at once; whoever comes then is refused."""
MOST_RECEIVED: Final = 16 * 1024 * 1024
"""Bytes of long requests in memory, of all clients: read in part, waiting or under way. What is
made of them can take twenty times as much."""
_log = logging.getLogger(__name__)


class About(Struct, frozen=True, kw_only=True):
    """What a session says about itself."""

    name: str
    """As its configuration calls it."""
    session: str
    """The id of its recording."""
    version: str
    """Of play-launch."""
    started_ns: int
    """Nanoseconds since the epoch."""


@contextlib.asynccontextmanager
async def serving(door: Door, about: About, operate: Operate) -> AsyncIterator[None]:
    """Answer who comes to the door while the block runs; it runs in any case."""
    for problem in door.problems:
        _log.warning("%s", problem)
    if door.socket is None:
        yield
        return
    server = Server(door.folder, about, operate)
    loop = asyncio.get_running_loop()
    # The path of the socket goes by a descriptor that may be another file's by now.
    keep_path: dict[str, Any] = {"cleanup_socket": False} if sys.version_info >= (3, 13) else {}
    listener = await loop.create_unix_server(server.connection, sock=door.socket, **keep_path)
    try:
        yield
    finally:
        await asyncio.to_thread(door.withdraw)
        listener.close()
        await server.close()


class Server:
    """The clients of a session. It belongs to the thread of the event loop."""

    def __init__(self, folder: str, about: About, operate: Operate) -> None:
        """Know what to answer."""
        self._operate = operate
        self._room = Room(MOST_RECEIVED)
        self._clients: set[Connection] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._greeting = encode(
            {
                "hello": {
                    "protocol": PROTOCOL,
                    "version": about.version,
                    "pid": os.getpid(),
                    "name": about.name,
                    "session": about.session,
                    "folder": folder,
                    "started_ns": about.started_ns,
                }
            }
        )

    def connection(self) -> Connection:
        """Make what serves the next client."""
        return Connection(
            greeting=self._greeting,
            operate=self._operate,
            room=self._room,
            admits=self._admits,
            spawn=self._spawn,
            on_end=self._clients.discard,
        )

    async def close(self) -> None:
        """End all conversations."""
        for client in tuple(self._clients):
            client.close()
        tasks = tuple(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for client in tuple(self._clients):
            client.abort()  # it does not read, and nobody waits for it

    def _admits(self, client: Connection, peer: Peer) -> str:
        if peer.uid not in {0, os.geteuid()}:
            return f"this session is of user {os.geteuid()}, and you are user {peer.uid}"
        if len(self._clients) >= MOST_CLIENTS:
            return f"{MOST_CLIENTS} others are connected already"
        self._clients.add(client)
        return ""

    def _spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task
