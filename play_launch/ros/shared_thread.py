"""One node of our own for all that need ROS now and then; it is there as long as one does."""

from __future__ import annotations

import asyncio
import os
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

import anyio

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Mapping

    from play_launch.ros.thread import RosThread


class SharedRosThread:
    """Belongs to one event loop."""

    def __init__(self, open_thread: Callable[[], RosThread]) -> None:
        """Take what makes a thread; it may import rclpy, so it is called in another thread."""
        self._open_thread = open_thread
        self._thread: RosThread | None = None
        self._users = 0
        self._lock = asyncio.Lock()

    @asynccontextmanager
    async def used(self) -> AsyncIterator[RosThread]:
        """Give the thread, which has begun, for the time of the block."""
        async with self._lock:
            if self._thread is None:
                self._thread = await asyncio.to_thread(self._open_thread)
                self._thread.begin()
            self._users += 1
        thread = self._thread
        try:
            yield thread
        finally:
            self._users -= 1
            if self._users == 0:
                self._thread = None
                thread.finish()
                with anyio.CancelScope(shield=True):
                    await asyncio.to_thread(thread.close)


def thread_in(environment: Mapping[str, str]) -> RosThread:
    """Make a thread with a hidden node in the domain of the system, which has not begun."""
    from play_launch.ros.thread import RosThread  # noqa: PLC0415 - imports rclpy

    domain = environment.get("ROS_DOMAIN_ID", "")
    return RosThread(f"_play_launch_{os.getpid()}_graph", domain_id=int(domain) if domain else None)
