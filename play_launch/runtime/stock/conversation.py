"""Requests to a stock container, in bounded waits."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import anyio

if TYPE_CHECKING:
    from play_launch.ros.composition import CompositionClient, ListedNode

_log = logging.getLogger(__name__)

_OPEN_LISTS: Final = 8
"""Requests for a list that may be open; answers get lost, and lists may be asked for at will."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StockLimits:
    """Seconds."""

    list_again: float = 0.25
    """From one request for a list to the next; it doubles up to `list_nodes`."""
    list_nodes: float = 3.0
    """After which a container is taken to answer nothing for now."""
    unload_node: float = 10.0
    look: float = 5.0
    """Between two comparisons with the list while nothing is loaded."""
    silence: float = 10.0
    """Of a container that loads nothing; then it is reported, and nothing else is done."""
    waiting: float = 10.0
    """For a container that something else starts; then its absence is reported."""
    lease: float = 30.0
    """After which no participant remembers a dead one."""


class Conversation:
    """Asks one container, and remembers its latest list and when it last answered."""

    def __init__(self, name: str, services: CompositionClient, limits: StockLimits) -> None:
        """Ask nothing yet."""
        self.services = services
        self.limits = limits
        self.listed: dict[int, str] = {}
        self._name = name
        self._loop = asyncio.get_running_loop()
        self._heard_at = 0.0
        self._is_silent = False

    async def list(self) -> dict[int, str]:
        """Ask for the nodes until there is an answer; it is younger than this call.

        The services of a process that was just killed are still in the graph, and answers are
        dropped before both sides have discovered each other: so it is asked for again.
        """
        asked: deque[asyncio.Future[tuple[ListedNode, ...]]] = deque()
        pause = self.limits.list_again
        try:
            while not (done := [reply for reply in asked if reply.done()]):
                if len(asked) == _OPEN_LISTS:
                    asked.popleft().cancel()
                asked.append(self.services.list_nodes())
                await asyncio.wait(asked, timeout=pause, return_when=asyncio.FIRST_COMPLETED)
                pause = min(2 * pause, self.limits.list_nodes)
            self.listed = dict(done[-1].result())
        finally:
            for reply in asked:
                reply.cancel()
        self.heard()
        return self.listed

    async def list_in_time(self) -> dict[int, str] | None:
        """Ask for the nodes; None when it does not answer now."""
        with anyio.move_on_after(self.limits.list_nodes):
            return await self.list()
        return None

    async def unload(self, unique_id: int) -> str:
        """Unload a node; returns why it is not unloaded, empty when it is."""
        await self.services.ready()
        limit = self.limits.unload_node
        reply, reason = self.services.unload_node(unique_id), f"no answer within {limit:g} s"
        if (await asyncio.wait({reply}, timeout=limit))[0]:
            self.heard()
            answer = reply.result()
            reason = "" if answer.success else answer.error_message or "it does not say why"
        reply.cancel()
        if reason:
            _log.warning("%s: node %d is not unloaded: %s", self._name, unique_id, reason)
        else:
            self.listed.pop(unique_id, None)
        return reason

    def heard(self) -> None:
        """It has answered."""
        self._heard_at = self._loop.time()
        if self._is_silent:
            self._is_silent = False
            _log.warning("%s answers again", self._name)

    def report_silence(self) -> None:
        """Report once that it has not answered for long, though it loads nothing."""
        silent = self._loop.time() - self._heard_at
        if silent > self.limits.silence and not self._is_silent:
            self._is_silent = True
            text = "%s has not answered for %.0f s: its executor is busy, or it is frozen"
            _log.warning(text, self._name, silent)
