"""Replaces the node when the machine's addresses change, without ever showing fewer nodes."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.graph_daemon.server.service import Graph, GraphService

LONGEST_WARM_UP: Final = 30.0
"""Seconds after which a replacement is used although it does not know all that the old one knows.

Fast DDS holds a participant for dead after 20 s of silence, so by then the old one has forgotten
whom it cannot reach any more, and the two agree; else something is odd, and the addresses of the
new one are the right ones.
"""
_LOOK: Final = 0.1
_RETRY: Final = 5.0
_log = logging.getLogger(__name__)


class Replacer:
    """Builds nodes in threads, and swaps them in the loop's thread.

    Args:
        service: Where the node is in use.
        build: Makes a node; called in a thread.
        look: Seconds between two comparisons.
        longest: Seconds after which a replacement is used in any case.
    """

    def __init__(
        self,
        service: GraphService,
        build: Callable[[], Graph],
        *,
        look: float = _LOOK,
        longest: float = LONGEST_WARM_UP,
        retry: float = _RETRY,
    ) -> None:
        self._service = service
        self._build = build
        self._look = look
        self._longest = longest
        self._retry = retry
        self._wanted = asyncio.Event()
        self.replacements = 0
        """How often the node was replaced."""

    def request(self) -> None:
        """Ask for a new node; while one is made, for another one after it."""
        self._wanted.set()

    async def run(self) -> None:
        """Replace the node whenever it is asked for; ends by cancellation."""
        while True:
            await self._wanted.wait()
            self._wanted.clear()
            try:
                await self._replace()
            except Exception:  # noqa: BLE001 - whatever rclpy raises, the daemon goes on
                # The old node still answers.
                _log.exception("no replacement for the node could be made")
                await asyncio.sleep(self._retry)
                self._wanted.set()

    async def _replace(self) -> None:
        _log.info("the machine's addresses have changed; making a new node")
        new = await asyncio.to_thread(self._build)
        old = self._service.graph
        try:
            deadline = time.monotonic() + self._longest
            while not covers(new, old):
                if time.monotonic() > deadline:
                    _log.warning("the new node does not know all that the old one knows")
                    break
                await asyncio.sleep(self._look)
        except BaseException:
            await asyncio.to_thread(new.close)
            raise
        self._service.use(new)
        self.replacements += 1
        _log.info("the new node is in use")
        await asyncio.to_thread(old.close)


def covers(new: Graph, old: Graph) -> bool:
    """Whether ``new`` knows every node, topic and service that ``old`` knows, but for itself."""
    own = {old.name, new.name}
    if any(name not in own for name, _ in set(old.nodes()) - set(new.nodes())):
        return False
    return all(
        {name for name, _ in old.call(method)} <= {name for name, _ in new.call(method)}
        for method in ("get_topic_names_and_types", "get_service_names_and_types")
    )
